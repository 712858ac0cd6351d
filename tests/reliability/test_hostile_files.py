"""Untrusted files open no file outside their folder, expand to no gigabytes, and execute no code."""

from __future__ import annotations

import base64
import io
import json
import pickle
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.errors import HirError
from hir_exporters.reading.mesh_import import load_mesh_asset
from hir_exporters.textures.image_files import encode_png, read_exr, read_hdr, read_ldr

from hir_plugins.initializers.existing_mesh.mesh_loading import load_mesh
from hir_plugins.readers.parsing.pose_files import load_arrays
from tests.reliability import seeds

SECRET = encode_png(np.full((2, 2, 3), 0.75, np.float32))


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """A folder next to files that it must not open."""
    (tmp_path / "secret.png").write_bytes(SECRET)
    (tmp_path / "secret.bin").write_bytes(b"\0" * 4096)
    (tmp_path / "secret.mtl").write_text("newmtl m\nKd 0.1 0.9 0.1\n")
    (tmp_path / "secret.usda").write_text('#usda 1.0\ndef Mesh "secret" { point3f[] points = [(0,0,0)] }\n')
    folder = tmp_path / "capture"
    folder.mkdir()
    return folder


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of all files that Python opens for reading from here on."""
    import builtins
    import os

    names: list[str] = []
    plain, low = builtins.open, os.open

    def recorded(file, *more, **options):  # type: ignore[no-untyped-def]
        names.append(str(file))
        return plain(file, *more, **options)

    def recorded_low(path, *more, **options):  # type: ignore[no-untyped-def]
        names.append(str(path))
        return low(path, *more, **options)

    monkeypatch.setattr(builtins, "open", recorded)
    monkeypatch.setattr(io, "open", recorded)
    monkeypatch.setattr(os, "open", recorded_low)
    return names


def triangle_gltf(**more: object) -> dict[str, object]:
    """A .gltf of one triangle whose buffer is embedded."""
    data = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32).tobytes()
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"uri": uri, "byteLength": 36}],
    } | more


def _buffer_outside(folder: Path) -> Path:
    path = folder / "a.gltf"
    path.write_text(json.dumps(triangle_gltf(buffers=[{"uri": "../secret.bin", "byteLength": 36}])))
    return path


def _image_outside(folder: Path) -> Path:
    path = folder / "a.gltf"
    document = triangle_gltf(
        images=[{"uri": "../secret.png"}],
        textures=[{"source": 0}],
        materials=[{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
    )
    document["meshes"] = [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}]
    path.write_text(json.dumps(document))
    return path


def _linked_image_outside(folder: Path) -> Path:
    path = _image_outside(folder)
    path.write_text(path.read_text().replace("../secret.png", "link.png"))
    (folder / "link.png").symlink_to("../secret.png")
    return path


def _material_outside(folder: Path) -> Path:
    path = folder / "a.obj"
    path.write_text("mtllib ../secret.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n")
    return path


def _texture_outside(folder: Path) -> Path:
    (folder / "a.mtl").write_text("newmtl m\nmap_Kd ../secret.png\n")
    path = folder / "a.obj"
    path.write_text("mtllib a.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n")
    return path


def _link_outside(folder: Path) -> Path:
    path = _texture_outside(folder)
    (folder / "a.mtl").write_text("newmtl m\nmap_Kd link.png\n")
    (folder / "link.png").symlink_to("../secret.png")
    return path


MESHES = [_buffer_outside, _image_outside, _linked_image_outside, _material_outside, _texture_outside, _link_outside]


@pytest.mark.parametrize("make", MESHES, ids=lambda f: f.__name__.strip("_"))
@pytest.mark.parametrize("read", [load_mesh, load_mesh_asset], ids=["start", "export"])
def test_meshes_open_nothing_outside_their_folder(
    make: Callable[[Path], Path], read: Callable[[Path], object], capture: Path, opened: list[str]
) -> None:
    path = make(capture)
    opened.clear()
    try:
        read(path)
    except HirError as error:
        assert str(error)
    outside = [name for name in opened if "secret" in name or "link.png" in name]
    assert not outside


def test_usd_composes_no_layer_outside_its_folder(capture: Path) -> None:
    path = capture / "a.usda"
    path.write_text("#usda 1.0\n(\n    subLayers = [@../secret.usda@]\n)\n")
    with pytest.raises(HirError) as found:
        load_mesh_asset(path)
    assert "outside" in str(found.value) or "leads" in str(found.value)


def test_a_usd_that_ends_openusd_is_refused(tmp_path: Path) -> None:
    """The fuzzer's finding: read in this process, it would end the tests (\"Dereferenced an invalid SdfPrimSpec\")."""
    (tmp_path / "x.usdz").write_bytes((Path(__file__).parent / "ends_openusd.usdz").read_bytes())
    with pytest.raises(HirError, match="OpenUSD ended without a result") as found:
        load_mesh_asset(tmp_path / "x.usdz")
    assert "\n" not in str(found.value)


def test_a_usd_is_read_with_no_module_of_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stranger's folder may hold a numpy.py; the process that reads must not take it."""
    from hir_exporters.formats import create_exporter

    create_exporter("usda").write(seeds.asset(), tmp_path / "x.usda")
    (tmp_path / "numpy.py").write_text("open('taken', 'w')\n")
    monkeypatch.chdir(tmp_path)
    assert len(load_mesh_asset(Path("x.usda")).mesh.faces) == len(seeds.asset().mesh.faces)
    assert not (tmp_path / "taken").exists()


def test_usd_reads_no_texture_outside_its_folder(capture: Path) -> None:
    from hir_exporters.formats import create_exporter

    path = capture / "a.usda"
    create_exporter("usda").write(seeds.asset(), path)
    text = path.read_text()
    name = next(word for word in text.split("@") if word.endswith(".png"))
    path.write_text(text.replace(f"@{name}@", "@../secret.png@"))
    with pytest.raises(HirError) as found:
        load_mesh_asset(path)
    assert "outside" in str(found.value) or "leads" in str(found.value)


def _png(width: int, height: int) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(b"\0" * 100000))
        + chunk(b"IEND", b"")
    )


def test_pictures_that_would_unfold_are_refused_by_their_header(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(_png(100_000, 100_000))
    (tmp_path / "a.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 900000000 +X 900000000\n" + b"\1" * 64)
    for name, read in (("a.png", read_ldr), ("a.hdr", read_hdr)):
        with pytest.raises(HirError, match="pixels"):
            read(tmp_path / name)
    import OpenEXR

    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Y": np.zeros((4, 4), np.float32)}).write(str(tmp_path / "a.exr"))
    data = bytearray((tmp_path / "a.exr").read_bytes())
    at = data.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    data[at : at + 16] = struct.pack("<4i", 0, 0, 99_999, 99_999)
    (tmp_path / "a.exr").write_bytes(bytes(data))
    with pytest.raises(HirError):
        read_exr(tmp_path / "a.exr")


def test_archives_of_numbers_that_would_unfold_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "cameras.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("world_mat_0.npy", b"\0" * (300 << 20))
    assert path.stat().st_size < 1 << 20
    with pytest.raises(HirError, match="decompresses"):
        load_arrays(path)


class Trap:
    """Creates a file when it is unpickled."""

    place = ""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        import os

        return os.mkdir, (self.place,)


def test_pickles_in_data_are_not_opened(tmp_path: Path) -> None:
    Trap.place = str(tmp_path / "sprung")
    trap = np.array([Trap()], dtype=object)
    np.savez(tmp_path / "cameras.npz", world_mat_0=trap)
    np.save(tmp_path / "poses_bounds.npy", trap)
    (tmp_path / "raw.npy").write_bytes(pickle.dumps(Trap()))
    for name in ("cameras.npz", "poses_bounds.npy", "raw.npy"):
        with pytest.raises(HirError):
            load_arrays(tmp_path / name)
    assert not (tmp_path / "sprung").exists()


def test_a_pickle_in_a_checkpoint_is_not_opened(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    from hir_core.optimization.checkpoints import read_arrays

    Trap.place = str(tmp_path / "sprung")
    np.savez(tmp_path / "state.npz", world_mat_0=np.array([Trap()], dtype=object))
    assert read_arrays(tmp_path / "state.npz") == {} and not (tmp_path / "sprung").exists()


def test_settings_name_what_exists_and_import_nothing_by_themselves(tmp_path: Path) -> None:
    from hir_core.config import load_config
    from hir_core.plugins.manager import PluginManager

    (tmp_path / "evil.py").write_text(f"import os; os.mkdir({str(tmp_path / 'sprung')!r})")
    (tmp_path / "a.toml").write_text('[geometry]\nrenderer = "evil:run"\n')
    with pytest.raises(HirError, match="evil:run"):
        load_config(PluginManager.discover(), file=tmp_path / "a.toml")
    assert not (tmp_path / "sprung").exists()


def test_a_file_of_settings_runs_no_code(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from hir_core.cli.app import main
    from hir_core.config import load_config
    from hir_core.plugins.manager import PluginManager

    code = tmp_path / "evil.py"
    code.write_text(f"import os; os.mkdir({str(tmp_path / 'sprung')!r})")
    (tmp_path / "a.toml").write_text(f"plugins = [{str(code)!r}]\n")
    with pytest.raises(HirError, match=r"a\.toml: plugins are not loaded .* --plugin FILE$"):
        load_config(PluginManager.discover(), file=tmp_path / "a.toml")
    with pytest.raises(SystemExit) as ended:
        main(["config", "show", "--config", str(tmp_path / "a.toml")])
    assert ended.value.code == 2 and "--plugin" in capsys.readouterr().err
    assert not (tmp_path / "sprung").exists()
    load_config(PluginManager.discover(), assignments=[f"plugins=[{str(code)!r}]"])
    assert (tmp_path / "sprung").exists(), "the command line may name it"
    (tmp_path / "b.toml").write_text("plugins = []\n")  # as `hir config show` prints it
    load_config(PluginManager.discover(), file=tmp_path / "b.toml")


def test_a_playlist_that_calls_itself_a_video_opens_nothing(capture: Path) -> None:
    pytest.importorskip("av", reason="videos are read by PyAV: pip install av")
    from hir_core.intake.reader_lookup import read_capture
    from hir_core.plugins.manager import PluginManager

    seeds.video(capture.parent)
    (capture.parent / "clip.mp4").rename(capture.parent / "secret.mp4")
    for text in (
        "ffconcat version 1.0\nfile ../secret.mp4\n",
        "#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n../secret.mp4\n#EXT-X-ENDLIST\n",
        "#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nhttp://127.0.0.1:9/x.ts\n#EXT-X-ENDLIST\n",
    ):
        (capture / "clip.mp4").write_text(text)
        with pytest.raises(HirError, match="cannot be opened as a video"):
            read_capture(capture, "train", PluginManager.discover())


def test_what_the_fuzzer_found_stays_mended(tmp_path: Path) -> None:
    """A preset that is a list, a photograph's name of 5000 letters, vertices of one number, indices from elsewhere."""
    from hir_core.config import load_config
    from hir_core.intake.reader_lookup import read_capture
    from hir_core.plugins.manager import PluginManager

    plugins = PluginManager.discover()
    for preset in ("preset = []", "preset = {}", "preset = 3"):
        (tmp_path / "a.toml").write_text(preset)
        with pytest.raises(HirError):
            load_config(plugins, file=tmp_path / "a.toml")
    (tmp_path / "model").mkdir()
    seeds.colmap_text(tmp_path / "model")
    images = tmp_path / "model" / "sparse" / "0" / "images.txt"
    images.write_text(images.read_text().replace("a.png", "a" * 5000 + ".png"))
    with pytest.raises(HirError):
        read_capture(tmp_path / "model", "train", plugins)
    (tmp_path / "thin.obj").write_text("v 0\nv 1\nv 2\nvt 0 1\nvt 1 1\nvt 1 0\nf 1/1 2/2 3/3\n")
    with pytest.raises(HirError, match=r"mesh\.positions does not have three numbers"):
        load_mesh_asset(tmp_path / "thin.obj")
    seeds.mesh(tmp_path)
    document = json.loads((tmp_path / "mesh.gltf").read_text())
    indices = document["bufferViews"][document["accessors"][0]["bufferView"]]
    indices["buffer"] = document["bufferViews"][document["accessors"][1]["bufferView"]]["buffer"]
    (tmp_path / "mixed.gltf").write_text(json.dumps(document))
    with pytest.raises(HirError, match=r"mesh\.faces has an index out of range"):
        load_mesh_asset(tmp_path / "mixed.gltf")
    square = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 1\nvt 1 1\nvt 1 0\nf 1/1 2/2 3/3\n"
    (tmp_path / "null.obj").write_text("mtllib a\0b.mtl\n" + square)
    with pytest.raises(HirError, match="which is not a file name"):
        load_mesh_asset(tmp_path / "null.obj")
    (tmp_path / "long.obj").write_text(f"mtllib {'a' * 5000}.mtl\n" + square)
    with pytest.warns(UserWarning, match="which is not in its folder"):
        assert len(load_mesh_asset(tmp_path / "long.obj").mesh.faces) == 1, "a material that is not there is none"
