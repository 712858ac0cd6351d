"""Recordings of Record3D, made here: axes, intrinsics, depth, confidence, selection of frames, and hostile archives."""

from __future__ import annotations

import json
import struct
import sys
import zipfile
from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import lzfse
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

from hir_core.capture import Capture, DepthPixels
from hir_core.errors import CaptureError, ConfigError
from hir_core.intake.reader_lookup import read_capture
from hir_core.plugins.manager import PluginManager
from hir_core.run.capture_store import fingerprint
from hir_plugins.readers import record3d as reader_module
from hir_plugins.readers.parsing.record3d_format import lzfse_blocks, recording_files

WIDTH, HEIGHT, FOCAL = 60, 80, 70.0
DEPTH_WIDTH, DEPTH_HEIGHT = 15, 20
PLUGINS = PluginManager.discover()

Files = dict[str, bytes]


def picture(level: int = 128, width: int = WIDTH, height: int = HEIGHT, noise: float = 0) -> bytes:
    """A photograph as PNG, which decoders recognise under any name, so that its pixels are known."""
    pixels = np.full((height, width, 3), float(level)) + noise * np.random.default_rng(level).normal(
        size=(height, width, 3)
    )
    stream = BytesIO()
    Image.fromarray(pixels.clip(0, 255).astype(np.uint8)).save(stream, "PNG")
    return stream.getvalue()


def depths(slope: float = 0.5) -> NDArray[np.float32]:
    """Metres, along the optical axis, of the plane z = 2 + slope·x in the camera's axes."""
    x = ((np.arange(DEPTH_WIDTH) + 0.5) / DEPTH_WIDTH * WIDTH - WIDTH / 2) / FOCAL
    return np.broadcast_to(2 / (1 - slope * x), (DEPTH_HEIGHT, DEPTH_WIDTH)).astype(np.float32)


POSES = [[*Rotation.from_euler("yxz", [40 * i, 10 - i, 5]).as_quat(), 0.1 * i, 0.2, 1.5 - i] for i in range(4)]


def recording(count: int = 2, **changes: Any) -> Files:
    document: dict[str, Any] = {"w": WIDTH, "h": HEIGHT, "dw": DEPTH_WIDTH, "dh": DEPTH_HEIGHT, "fps": 60}
    document["K"] = [FOCAL, 0, 0, 0, FOCAL, 0, WIDTH / 2, HEIGHT / 2, 1]
    document["poses"] = (POSES * (count // len(POSES) + 1))[:count]
    document |= changes
    levels = np.tile(np.arange(3, dtype=np.uint8), DEPTH_HEIGHT * DEPTH_WIDTH // 3)
    files = {"metadata": json.dumps({k: v for k, v in document.items() if v is not None}).encode(), "icon": b"-"}
    for i in range(count):
        files[f"rgbd/{i}.jpg"] = picture(60 + i % 100)
        files[f"rgbd/{i}.depth"] = lzfse.compress(depths().tobytes())
        files[f"rgbd/{i}.conf"] = lzfse.compress(levels.tobytes())
    return files


def archive(path: Path, files: Files, compression: int = zipfile.ZIP_STORED) -> Path:
    with zipfile.ZipFile(path, "w", compression) as stream:
        for name, content in files.items():
            stream.writestr(name, content)
    return path


def unpacked(folder: Path, files: Files) -> Path:
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


def read(path: Path) -> Capture:
    found = read_capture(path, "train", PLUGINS)
    assert found.reader == "record3d"
    return found


def measured(found: Capture, view: int = 0) -> DepthPixels:
    """Those of low confidence, too."""
    chosen = found.views[view]
    assert chosen.depth is not None
    return (replace(chosen, depth=replace(chosen.depth, min_confidence=0.0)).measured_depth() or pytest.fail("none"))[1]


def test_a_point_projects_where_arkit_says(tmp_path: Path) -> None:
    """The camera looks along −z of its pose, y is up; the world stays as it is, in metres."""
    found = read(archive(tmp_path / "a.r3d", recording(4)))
    np.testing.assert_array_equal(found.world_from_source, np.eye(4))
    for pose, camera in zip(POSES, found.cameras, strict=True):
        local = np.array([0.3, 0.4, -2.0])
        point = Rotation.from_quat(pose[:4]).apply(local) + pose[4:]
        pixel, depth = camera.project(point[None])
        expected = [WIDTH / 2 + FOCAL * local[0] / 2, HEIGHT / 2 - FOCAL * local[1] / 2]
        np.testing.assert_allclose(pixel, [expected], atol=1e-9)
        assert depth[0] == pytest.approx(2.0)


def test_intrinsics_are_by_columns_and_those_of_a_frame_come_first(tmp_path: Path) -> None:
    k = [50.0, 0, 0, 0, 55.0, 0, 28.0, 41.0, 1]
    one = read(archive(tmp_path / "a.r3d", recording(K=k))).cameras[1].intrinsics
    np.testing.assert_array_equal(one, np.array(k).reshape(3, 3).T)
    frames = [[50.0, 55.0, 28.0, 41.0], [51.0, 56.0, 29.0, 42.0]]
    other = read(archive(tmp_path / "b.r3d", recording(perFrameIntrinsicCoeffs=frames))).cameras[1].intrinsics
    np.testing.assert_array_equal(other, [[51, 0, 29], [0, 56, 42], [0, 0, 1]])
    larger = recording() | {f"rgbd/{i}.jpg": picture(width=2 * WIDTH, height=2 * HEIGHT) for i in range(2)}
    scaled = read(archive(tmp_path / "c.r3d", larger)).cameras[0]
    assert (scaled.width, scaled.intrinsics[0, 0], scaled.intrinsics[1, 2]) == (120, 140, 80)


@pytest.mark.parametrize("says_size", [True, False])
def test_depths_are_metres_and_confidences_arkits(says_size: bool, tmp_path: Path) -> None:
    sizes = {} if says_size else {"dw": None, "dh": None}
    files = recording(**sizes)
    unknown = depths().copy()
    unknown[0, :3] = np.nan, 0, -1
    files["rgbd/1.depth"] = lzfse.compress(unknown.tobytes())
    del files["rgbd/1.conf"]
    found = read(archive(tmp_path / "a.r3d", files))
    pixels = measured(found)
    np.testing.assert_array_equal(pixels.depth, depths())
    np.testing.assert_array_equal(pixels.confidence.ravel()[:6], np.array([0, 0.5, 1, 0, 0.5, 1], np.float32))
    second = measured(found, 1)
    np.testing.assert_array_equal(second.depth[0, :4], [0, 0, 0, depths()[0, 3]])
    np.testing.assert_array_equal(second.confidence, (second.depth > 0).astype(np.float32))


def test_depths_keep_their_unit_when_the_world_is_scaled(tmp_path: Path) -> None:
    moved = read(archive(tmp_path / "a.r3d", recording())).transformed(np.diag([4.0, 4.0, 4.0, 1.0]))
    np.testing.assert_allclose(measured(moved).depth, 4 * depths(), rtol=1e-6)


@pytest.mark.parametrize("compression", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_an_unpacked_recording_is_the_same(compression: int, tmp_path: Path) -> None:
    packed = read(archive(tmp_path / "a.r3d", recording(), compression))
    loose = read(unpacked(tmp_path / "loose", recording()))
    for one, other in zip(packed.views, loose.views, strict=True):
        np.testing.assert_array_equal(one.pixels().color_linear, other.pixels().color_linear)
        np.testing.assert_array_equal(one.camera.world_to_camera, other.camera.world_to_camera)  # type: ignore[union-attr]
        np.testing.assert_array_equal(one.measured_depth()[1].depth, other.measured_depth()[1].depth)  # type: ignore[index]


def test_masks_lie_beside_the_recording(tmp_path: Path) -> None:
    """In its folder; a file alone has none, because those beside it may belong to something else."""
    archive(tmp_path / "a.r3d", recording())
    (tmp_path / "masks").mkdir()
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[10:20] = 255
    Image.fromarray(mask).save(tmp_path / "masks" / "1.png")
    inside = read(tmp_path)
    assert [view.pixels().mask is not None for view in inside.views] == [False, True]
    np.testing.assert_array_equal(inside.views[1].pixels().mask, mask / 255)
    assert read(tmp_path / "a.r3d").views[1].pixels().mask is None


def test_masks_of_frames_that_are_not_taken_belong_to_them(
    tmp_path: Path, recwarn: pytest.WarningsRecorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reader_module, "FRAMES", 2)
    archive(tmp_path / "a.r3d", recording(6))
    (tmp_path / "masks").mkdir()
    for name in ("1", "2", "4", "5"):
        Image.fromarray(np.zeros((HEIGHT, WIDTH), np.uint8)).save(tmp_path / "masks" / f"{name}.png")
    assert [view.name for view in read(tmp_path).views] == ["00000", "00003"] and not recwarn
    (tmp_path / "masks" / "1.png").rename(tmp_path / "masks" / "x.png")
    read(tmp_path)
    [warning] = recwarn
    assert "3 of 4 masks belong to a photograph" in str(warning.message) and "x.png" in str(warning.message)


def test_the_sharpest_frames_are_taken(tmp_path: Path) -> None:
    files = recording(400)
    for i in range(2, 400, 5):
        files[f"rgbd/{i}.jpg"] = picture(128, noise=20)
    found = read(archive(tmp_path / "a.r3d", files))
    assert [view.name for view in found.views] == [f"{i:05d}" for i in range(2, 400, 5)]


def test_frames_without_photograph_are_left_out_with_a_warning(tmp_path: Path) -> None:
    files = recording(4)
    del files["rgbd/2.jpg"]
    path = archive(tmp_path / "a.r3d", files)
    with pytest.warns(UserWarning, match=r"1 frames of a\.r3d have no photograph"):
        assert [view.name for view in read(path).views] == ["00000", "00001", "00003"]


def test_without_the_decompression_a_warning_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = archive(tmp_path / "a.r3d", recording())
    monkeypatch.setattr(reader_module, "find_spec", lambda name: None)
    with pytest.warns(UserWarning, match="pip install lzfse"):
        assert all(view.depth is None for view in read(path).views)


def test_decompressing_without_the_library_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    content = lzfse.compress(bytes(8))
    monkeypatch.setitem(sys.modules, "lzfse", None)
    with pytest.raises(ConfigError, match="pip install lzfse"):
        lzfse_blocks.decompress(content, 8)


def test_a_changed_recording_is_another_capture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And its file, which all frames share, is read once for that."""
    path = archive(tmp_path / "a.r3d", recording())
    before = fingerprint(read(path))
    archive(path, recording(K=[FOCAL, 0, 0, 0, FOCAL, 0, WIDTH / 2, HEIGHT / 2, 1]) | {"icon": b"another"})
    assert fingerprint(read(path)) != before
    hashed: list[Path] = []
    monkeypatch.setattr("hir_core.run.capture_store.file_hash", lambda p: hashed.append(p) or "0")
    fingerprint(read(path))
    assert hashed == [path]


def test_large_archives_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of more than 65,535 files end with other records (zip64)."""
    monkeypatch.setattr(zipfile, "ZIP_FILECOUNT_LIMIT", 3)
    path = archive(tmp_path / "a.r3d", recording(3))
    assert b"PK\6\6" in path.read_bytes()
    assert len(read(path).views) == 3


def without(name: str) -> Callable[[Files], Files]:
    return lambda files: {key: value for key, value in files.items() if key != name}


def with_file(name: str, content: bytes) -> Callable[[Files], Files]:
    return lambda files: files | {name: content}


def with_metadata(**changes: Any) -> Callable[[Files], Files]:
    return lambda files: files | {"metadata": recording(**changes)["metadata"]}


def copying_block(copies: int) -> bytes:
    """A block of LZFSE that states few bytes and copies many."""
    return b"bvx2" + struct.pack("<IQQQ", DEPTH_WIDTH * DEPTH_HEIGHT * 4, copies << 40, 0, 32) + b"bvx$"


REFUSED: dict[str, tuple[Callable[[Files], Files], str]] = {
    "no metadata": (without("metadata"), "holds no 'metadata'"),
    "metadata is a list": (with_file("metadata", b"[]"), "metadata is not a JSON object"),
    "metadata is no JSON": (with_file("metadata", b"{"), "metadata is not valid JSON"),
    "no size": (with_metadata(w=None), "has no 'w' and 'h'"),
    "impossible size": (with_metadata(w=-3), "no size of an image"),
    "no poses": (with_metadata(poses=None), "no list of numbers 'poses'"),
    "short poses": (with_metadata(poses=[[0, 0, 0, 1, 0, 0]]), "no list of numbers 'poses'"),
    "text as poses": (with_metadata(poses="many"), "no list of numbers 'poses'"),
    "zero quaternion": (with_metadata(poses=[[0.0] * 7] * 2), "without direction"),
    "infinite position": (with_metadata(poses=[[0, 0, 0, 1, 1e999, 0, 0]] * 2), "NaN or infinite"),
    "far away": (with_metadata(poses=[[0, 0, 0, 1, 1e12, 0, 0]] * 2), "units from the origin"),
    "no focal length": (with_metadata(K=[0.0] * 9), "focal length"),
    "intrinsics of other frames": (with_metadata(perFrameIntrinsicCoeffs=[[1, 1, 1, 1]]), "1 intrinsics and 2 poses"),
    "huge depth": (with_metadata(dw=60000, dh=60000), "depth maps of 60000×60000"),
    "no photographs": (lambda f: {k: v for k, v in f.items() if ".jpg" not in k}, "no photograph with a camera"),
    "photograph is text": (with_file("rgbd/0.jpg", b"none"), r"rgbd/0\.jpg is not an image"),
    "photographs differ": (with_file("rgbd/1.jpg", picture(width=30, height=40)), r"rgbd/1\.jpg is 30×40"),
    "depth is text": (
        with_file("rgbd/0.depth", b"a text of several words"),
        r"0\.depth is damaged \(it is not compressed with LZFSE\)",
    ),
    "depth is cut off": (
        with_file("rgbd/0.depth", lzfse.compress(depths().tobytes())[:40]),
        r"0\.depth is damaged \(it is cut off\)",
    ),
    "depth of another size": (
        with_file("rgbd/0.depth", lzfse.compress(bytes(400))),
        r"0\.depth is damaged \(it holds 400 bytes instead of 1200\)",
    ),
    "confidence of another size": (with_file("rgbd/0.conf", lzfse.compress(bytes(4))), r"0\.conf is damaged"),
    "depth that grows": (with_file("rgbd/0.depth", copying_block(10_000)), r"0\.depth is damaged"),
    "endless blocks": (with_file("rgbd/0.depth", b"bvx-\0\0\0\0" * 1000), r"0\.depth is damaged \(it is cut off\)"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_wrong_is_a_sentence_that_names_the_file(case: str, tmp_path: Path) -> None:
    change, message = REFUSED[case]
    path = archive(tmp_path / "a.r3d", change(recording()))
    with pytest.raises(CaptureError, match=message) as caught:
        for view in read(path).views:
            view.pixels()
            view.measured_depth()
    assert str(tmp_path) in str(caught.value)


def test_a_depth_that_fills_no_map_of_the_photographs_shape(tmp_path: Path) -> None:
    files = recording(dw=None, dh=None) | {"rgbd/0.depth": lzfse.compress(bytes(4 * 301))}
    with pytest.raises(CaptureError, match="301 depths fill no map"):
        read(archive(tmp_path / "a.r3d", files)).views[0].measured_depth()


def test_damaged_archives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = archive(tmp_path / "a.r3d", recording()).read_bytes()
    cut = tmp_path / "cut.r3d"
    for length in (0, 10, len(whole) // 2, len(whole) - 30):
        cut.write_bytes(whole[:length])
        with pytest.raises(CaptureError, match=r"cut\.r3d is no recording of Record3D"):
            read(cut)
    at = whole.index(picture(60)) + 60
    cut.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
    with pytest.raises(CaptureError, match=r"rgbd/0\.jpg is damaged \(its checksum is wrong\)"):
        read(cut)
    cut.write_bytes(whole.replace(b"PK\3\4", b"PK\3\5"))
    with pytest.raises(CaptureError, match=r"metadata is damaged \(its header is missing\)"):
        read(cut)
    monkeypatch.setattr(recording_files, "MAX_DIRECTORY_BYTES", 100)
    with pytest.raises(CaptureError, match="lists files"):
        read(tmp_path / "a.r3d")


def test_a_file_that_says_less_than_it_unpacks_to(tmp_path: Path) -> None:
    """It is not unpacked further than it says."""
    path = archive(tmp_path / "a.r3d", recording() | {"metadata": bytes(10 << 20)}, zipfile.ZIP_DEFLATED)
    content = path.read_bytes()
    true = struct.pack("<I", 10 << 20)
    assert content.count(true) == 2, "in the header and in the list of files"
    path.write_bytes(content.replace(true, struct.pack("<I", 100)))
    with pytest.raises(CaptureError, match="metadata is damaged"):
        read(path)


def test_copies_are_bounded_by_what_a_stream_states() -> None:
    """10,000 copies in 40 bytes could fill 23 MB; of the longest real streams none has a copy for three bytes."""
    with pytest.raises(ValueError, match="it holds"):
        lzfse_blocks.decompress(copying_block(10_000), DEPTH_WIDTH * DEPTH_HEIGHT * 4)
    random = np.random.default_rng(0)
    for content in (
        np.tile(np.arange(4, dtype=np.uint8), 50_000).tobytes(),
        random.integers(0, 3, 200_000, dtype=np.uint8).tobytes(),
        (1 + random.random(50_000)).astype(np.float16).astype(np.float32).tobytes(),
        b"".join(random.permutation([b"abcd", b"efgh", b"ijkl", b"mnop"]).tobytes() for _ in range(10_000)),
    ):
        assert lzfse_blocks.decompress(lzfse.compress(content), len(content)) == content


def test_a_folder_with_links_outside_is_read_without_them(tmp_path: Path) -> None:
    folder = unpacked(tmp_path / "loose", recording())
    (tmp_path / "secret.png").write_bytes(picture(200))
    (folder / "rgbd" / "1.jpg").unlink()
    (folder / "rgbd" / "1.jpg").symlink_to(tmp_path / "secret.png")
    with pytest.warns(UserWarning, match="1 frames"):
        assert [view.name for view in read(folder).views] == ["00000"]
