"""Mesh files name files of their folder only, are read in bounded time, and refuse nonsense in one sentence."""

from __future__ import annotations

import base64
import contextlib
import io
import json
import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.errors import HirError
from hir_exporters.reading.gltf_readback import read_gltf
from hir_exporters.reading.mesh_import import load_mesh_asset
from hir_exporters.reading.mesh_references import load_mesh_scene
from PIL import Image

from tests.reliability.test_hostile_files import triangle_gltf

SECONDS = 20.0
"""Each of the large files took minutes, or more memory than a machine has."""

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "secret.bin").write_bytes(b"\0" * 4096)
    (tmp_path / "mesh").mkdir()
    return tmp_path / "mesh"


def addresses(folder: Path) -> list[str]:
    secret = folder.parent / "secret.bin"
    return [
        "../secret.bin",
        "..%2fsecret.bin",
        "%2e%2e/secret.bin",
        "..%252fsecret.bin",
        "..\\secret.bin",
        "..%5Csecret.bin",
        "a/../../secret.bin",
        str(secret),
        f"file://{secret}",
        f"file:{secret}",
        "C:\\secret.bin",
        "http://127.0.0.1:9/secret.bin",
        "link.bin",
    ]


def test_no_address_of_a_gltf_leads_out_of_its_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every spelling, as buffer and as image, in .gltf and in an extension; nothing outside is opened."""
    (folder / "link.bin").symlink_to("../secret.bin")
    (folder / "a").mkdir()
    read: list[str] = []
    plain = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda path: read.append(str(path.resolve())) or plain(path))
    for uri in addresses(folder):
        for more in (
            {"buffers": [{"uri": uri, "byteLength": 36}]},
            {"images": [{"uri": uri}]},
            {"extensions": {"KHR_other": {"files": [{"uri": uri}]}}},
        ):
            (folder / "a.gltf").write_text(json.dumps(triangle_gltf(**more)))
            for reader in (load_mesh_asset, read_gltf):
                with pytest.raises(HirError, match="its folder") as found:
                    reader(folder / "a.gltf")
                assert "\n" not in str(found.value)
    assert not [name for name in read if name.endswith("secret.bin")]


def test_trimesh_gets_no_file_from_outside(folder: Path) -> None:
    """The check of the whole file is repeated where trimesh asks for a file."""
    from hir_exporters.reading.mesh_references import _contained_resolver

    (folder / "link.bin").symlink_to("../secret.bin")
    resolver = _contained_resolver(folder / "a.gltf")
    for uri in addresses(folder):
        for ask in (resolver.get, resolver.__getitem__):
            with pytest.raises(HirError):
                ask(uri)


def test_a_gltf_may_name_files_of_subfolders(folder: Path) -> None:
    from hir_exporters.reading.mesh_references import contained_file

    (folder / "a b").mkdir()
    (folder / "a b" / "c.bin").write_bytes(b"x")
    assert contained_file(folder / "a.gltf", "a%20b/c.bin", percent_encoded=True).read_bytes() == b"x"


@pytest.mark.parametrize("statement", ["mtllib {}", "mtllib a.mtl"])
def test_no_statement_of_an_obj_leads_out_of_its_folder(statement: str, folder: Path) -> None:
    for name in ("../secret.bin", "..\\secret.bin", str(folder.parent / "secret.bin"), "file:../secret.bin"):
        for key in ("map_Kd", "map_Ks", "map_Pr", "norm", "bump", "disp", "map_Kd -bm 1.0"):
            (folder / "a.mtl").write_text(f"newmtl m\n{key} {name}\n")
            (folder / "a.obj").write_text(statement.format(name) + "\nusemtl m\n" + TRIANGLE)
            with pytest.raises(HirError, match="its folder"):
                load_mesh_asset(folder / "a.obj")


def _pipe_as_texture(folder: Path) -> Path:
    os.mkfifo(folder / "t.png")
    (folder / "a.mtl").write_text("newmtl m\nmap_Kd t.png\n")
    (folder / "a.obj").write_text("mtllib a.mtl\nusemtl m\n" + TRIANGLE)
    return folder / "a.obj"


def _pipe_as_library(folder: Path) -> Path:
    os.mkfifo(folder / "a.mtl")
    (folder / "a.obj").write_text("mtllib a.mtl\nusemtl m\n" + TRIANGLE)
    return folder / "a.obj"


def _pipe_as_buffer(folder: Path) -> Path:
    os.mkfifo(folder / "a.bin")
    (folder / "a.gltf").write_text(json.dumps(triangle_gltf(buffers=[{"uri": "a.bin", "byteLength": 36}])))
    return folder / "a.gltf"


def _many_instances(folder: Path) -> Path:
    nodes = [{"mesh": 0, "translation": [i, 0, 0]} for i in range(200_000)]
    document = triangle_gltf(nodes=nodes, scenes=[{"nodes": list(range(len(nodes)))}])
    (folder / "a.gltf").write_text(json.dumps(document))
    return folder / "a.gltf"


def _many_instances_of_many_primitives(folder: Path) -> Path:
    """9,999 nodes of a mesh of 1,000 primitives."""
    document = triangle_gltf(nodes=[{"mesh": 0}] * 9_999, scenes=[{"nodes": list(range(9_999))}])
    document["meshes"] = [{"primitives": [{"attributes": {"POSITION": 0}}] * 1_000}]
    (folder / "a.gltf").write_text(json.dumps(document))
    return folder / "a.gltf"


def _vast_accessor(folder: Path) -> Path:
    accessor = {"componentType": 5126, "count": 10**10, "type": "VEC3"}
    (folder / "a.gltf").write_text(json.dumps(triangle_gltf(accessors=[accessor])))
    return folder / "a.gltf"


def _many_corners(folder: Path) -> Path:
    (folder / "a.obj").write_text(TRIANGLE + "f " + "1/1 2/2 3/3 " * 1_000_000 + "\n")
    return folder / "a.obj"


def _many_corners_on_many_lines(folder: Path) -> Path:
    (folder / "a.obj").write_text(TRIANGLE + "f \\\n" + "1/1 2/2 3/3 \\\n" * 1_000_000 + "\n")
    return folder / "a.obj"


def _long_index(folder: Path) -> Path:
    (folder / "a.obj").write_text(TRIANGLE + "f " + "9" * 5000 + "/1 2/2 3/3\n")
    return folder / "a.obj"


def _negative_refraction(folder: Path) -> Path:
    material = {"extensions": {"KHR_materials_ior": {"ior": -1}}, "pbrMetallicRoughness": {}}
    document = triangle_gltf(materials=[material], extensionsUsed=["KHR_materials_ior"])
    document["meshes"] = [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": 0}]}]
    document["accessors"] = [*document["accessors"], {"componentType": 5126, "count": 3, "type": "VEC2"}]  # type: ignore[misc]
    (folder / "a.gltf").write_text(json.dumps(document))
    return folder / "a.gltf"


REFUSED = {
    _pipe_as_texture: "not a regular file",
    _pipe_as_library: "not a regular file",
    _pipe_as_buffer: "not a regular file",
    _many_instances: "200000 nodes",
    _many_instances_of_many_primitives: "more than 10000 primitives",
    _vast_accessor: "elements",
    _many_corners: "corners",
    _many_corners_on_many_lines: "corners",
    _long_index: "too many digits",
    _negative_refraction: "index of refraction is -1",
}


def surface_of(path: Path) -> object:
    """As `hir check --mesh` and `hir evaluate --mesh` read it."""
    return load_mesh_scene(path).to_mesh()


@pytest.mark.parametrize("kind", ["two places", "two codes"])
def test_no_library_decodes_another_picture_than_the_checked_one(
    kind: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An EPS would start Ghostscript. trimesh prefers `bufferView` to `uri`, and what follows `base64,` last."""
    from PIL import EpsImagePlugin

    from hir_plugins.initializers.existing_mesh.mesh_loading import load_mesh

    eps = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 8\n%%EndComments\nshowpage\n"
    stream = io.BytesIO()
    Image.new("RGB", (2, 2)).save(stream, "PNG")
    png, triangle = base64.b64encode(stream.getvalue()).decode(), triangle_gltf()
    uvs = np.zeros((3, 2), np.float32).tobytes()
    first = base64.b64decode(triangle["buffers"][0]["uri"].partition(",")[2])  # type: ignore[index]
    content = first + uvs + eps
    picture = {"uri": f"data:image/png;base64,{png}", "bufferView": 2}
    if kind == "two codes":
        picture = {"uri": f"data:image/png,{png}base64,{base64.b64encode(eps).decode()}"}
    uri = "data:application/octet-stream;base64," + base64.b64encode(content).decode()
    document = triangle | {
        "buffers": [{"uri": uri, "byteLength": len(content)}],
        "bufferViews": [
            {"buffer": 0, "byteLength": 36},
            {"buffer": 0, "byteOffset": 36, "byteLength": 24},
            {"buffer": 0, "byteOffset": 60, "byteLength": len(eps)},
        ],
        "images": [picture | {"mimeType": "image/png"}],
        "textures": [{"source": 0}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": 0}]}],
        "accessors": [*triangle["accessors"], {"bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC2"}],  # type: ignore[misc]
    }
    (folder / "a.gltf").write_text(json.dumps(document))
    started: list[object] = []
    monkeypatch.setattr(EpsImagePlugin, "Ghostscript", lambda *given, **named: started.append(given))
    for read in (load_mesh_asset, load_mesh, surface_of):
        with contextlib.suppress(HirError):
            read(folder / "a.gltf")
    assert not started


@pytest.mark.parametrize("make", REFUSED, ids=lambda f: f.__name__.strip("_"))
def test_hostile_meshes_are_one_sentence_in_bounded_time(
    make: Callable[[Path], Path], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from hir_core.cli.app import main

    path = make(folder)
    started = time.perf_counter()
    with pytest.raises(SystemExit) as ended:
        main(["export", str(path), "-f", "glb", "-o", str(folder / "out")])
    message = capsys.readouterr().err
    assert ended.value.code == 2, message
    assert REFUSED[make] in message and message.strip().count("\n") == 0
    assert time.perf_counter() - started < SECONDS
