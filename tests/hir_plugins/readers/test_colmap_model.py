"""COLMAP models: the text form by hand, the binary form against COLMAP's own writer."""

from __future__ import annotations

import shutil
import struct
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from PIL import Image

from hir_core.errors import CaptureError
from hir_core.plugins import NoOptions
from hir_plugins.readers.colmap_model import ColmapModelReader
from hir_plugins.readers.parsing.colmap_format.colmap_files import read_points
from hir_plugins.readers.parsing.colmap_format.colmap_lenses import lens_camera
from hir_plugins.readers.parsing.upright import upright_rotation
from tests.fixtures.silhouette_captures import dome, look_at

READER = ColmapModelReader(NoOptions())
# a camera at (0, 0, -5) that looks along +Z with y down: COLMAP's axes are OpenCV's
CAMERAS = "# comment\n1 SIMPLE_RADIAL 64 48 80 32 24 0.0\n"
IMAGES = "# comment\n1 1 0 0 0 0 0 5 1 a.png\n10 10 -1\n2 0.5 0.5 0.5 0.5 0 0 5 1 b.png\n\n"
POINTS = "1 0.5 -0.75 0 255 0 128 0.5 1 0\n"


@pytest.fixture
def model(picture: Path) -> Path:
    shutil.copy(picture / "images" / "a.png", picture / "images" / "b.png")
    folder = picture / "sparse" / "0"
    folder.mkdir(parents=True)
    for name, text in (("cameras", CAMERAS), ("images", IMAGES), ("points3D", POINTS)):
        (folder / f"{name}.txt").write_text(text)
    return picture


def test_a_point_lands_on_its_pixel(model: Path) -> None:
    capture = READER.read(model)
    assert [v.name for v in capture.views] == ["a", "b"] and capture.points is not None
    # in COLMAP's axes: 0.5 to the right, 0.75 up, 5 in front
    pixels, depth = capture.cameras[0].project(capture.points.positions)
    np.testing.assert_allclose(pixels, [[32 + 80 * 0.5 / 5, 24 - 80 * 0.75 / 5]], atol=1e-9)
    np.testing.assert_allclose(depth, [5.0])
    moved = capture.world_from_source @ [0.5, -0.75, 0, 1]
    np.testing.assert_allclose(capture.points.positions[0], moved[:3])
    # 40.5, 12.5 is the centre of the one bright pixel
    assert np.argwhere(capture.views[0].pixels().color_linear[..., 0] > 0.5).tolist() == [[12, 40]]
    assert capture.points.colors is not None
    np.testing.assert_allclose(capture.points.colors, [[1, 0, 0.2158605]], atol=1e-6)


def test_the_quaternion_is_scalar_first(model: Path) -> None:
    # (0.5, 0.5, 0.5, 0.5) turns x to y, y to z, z to x
    second = READER.read(model)
    rotation = second.cameras[1].world_to_camera @ second.world_from_source
    np.testing.assert_allclose(rotation[:3, :3], [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-12)


def test_binary_equals_text(model: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    text = READER.read(model)
    binary = tmp_path_factory.mktemp("binary")
    shutil.copytree(model / "images", binary / "images")
    (binary / "sparse").mkdir()
    # COLMAP reads our text and writes it again as binary
    pycolmap.Reconstruction(str(model / "sparse" / "0")).write_binary(str(binary / "sparse"))
    again = READER.read(binary)
    for old, new in zip(text.cameras, again.cameras, strict=True):
        np.testing.assert_allclose(new.world_to_camera, old.world_to_camera, atol=1e-12)
        np.testing.assert_allclose(new.intrinsics, old.intrinsics)
    assert text.points is not None and again.points is not None
    np.testing.assert_allclose(again.points.positions, text.points.positions)


def test_cut_binaries_are_one_error(model: Path) -> None:
    folder = model / "sparse" / "0"
    pycolmap.Reconstruction(str(folder)).write_binary(str(folder))
    for name in ("cameras.bin", "images.bin", "points3D.bin"):
        whole = (folder / name).read_bytes()
        for content in (whole[:-3], whole[:5], struct.pack("<Q", 2**60) + whole[8:], b""):
            (folder / name).write_bytes(content)
            with pytest.raises(CaptureError, match=name):
                READER.read(model)
        (folder / name).write_bytes(whole)
    READER.read(model)


@pytest.mark.parametrize(
    ("file", "text", "says"),
    [
        ("cameras.txt", "1 PINHOLE 64 48 80\n", "PINHOLE"),
        ("cameras.txt", "1 SIMPLE_RADIAL 64 48 80 32 24 nan\n", "NaN"),
        ("cameras.txt", "1 FOV 64 48 80 80 32 24 0.1\n", "undistort"),
        ("cameras.txt", "1 SIMPLE_RADIAL 64 48 80 32 24 -40\n", "fold"),
        ("cameras.txt", "2 SIMPLE_PINHOLE 64 48 80 32 24\n", "camera 1"),
        ("cameras.txt", "", "without cameras"),
        ("images.txt", "1 1 0 0 0 0 0 5 1\n", "not an image"),
        ("images.txt", "1 0 0 0 0 0 0 5 1 a.png\n\n", "rotation"),
        ("images.txt", "1 1 0 0 0 0 0 5 1 ../a.png\n\n", "a.png"),
        ("images.txt", "1 1 0 0 0 0 0 5 1 missing.png\n\n", "missing.png"),
        ("points3D.txt", "1 0 0\n", "too short"),
    ],
)
def test_broken_text_is_one_clear_error(model: Path, file: str, text: str, says: str) -> None:
    (model / "sparse" / "0" / file).write_text(text)
    with pytest.raises(CaptureError, match=says) as caught:
        READER.read(model)
    assert "\n" not in str(caught.value)


def test_lens_models_agree_with_colmap() -> None:
    rng = np.random.default_rng(0)
    for model, parameters in {
        "SIMPLE_RADIAL": [80, 32, 24, 0.1],
        "RADIAL": [80, 32, 24, 0.1, -0.05],
        "OPENCV": [80, 82, 31, 25, 0.1, -0.05, 0.002, -0.003],
        "FULL_OPENCV": [80, 82, 31, 25, 0.1, -0.05, 0.002, -0.003, 0.01, 0.02, 0.01, 0.005],
        "OPENCV_FISHEYE": [80, 82, 31, 25, 0.1, -0.05, 0.01, 0.003],
        "RADIAL_FISHEYE": [80, 32, 24, 0.1, -0.05],
    }.items():
        from hir_core.capture.lens import Lens

        lens = lens_camera(model, parameters, 64, 48, "x")
        numbers = (lens.fx, lens.fy, lens.cx, lens.cy)
        ours = Lens(numbers, lens.coefficients, lens.model, numbers)
        local = rng.uniform(-0.3, 0.3, (20, 2))
        theirs = pycolmap.Camera(model=model, width=64, height=48, params=parameters)
        expected = np.array([theirs.img_from_cam(np.array([x, y, 1.0])) for x, y in local])
        found = ours.distort(local * [lens.fx, lens.fy] + [lens.cx, lens.cy])
        np.testing.assert_allclose(found, expected, atol=1e-9, err_msg=model)


def test_masks_beside_the_images(model: Path) -> None:
    (model / "masks").mkdir()
    mask = np.zeros((48, 64), np.uint8)
    mask[10:20, 30:50] = 255
    Image.fromarray(mask).save(model / "masks" / "a.png.png")
    views = READER.read(model).views
    found = views[0].pixels().mask
    assert found is not None and found.sum() == 200
    assert views[1].pixels().mask is None


def test_up_is_what_the_cameras_agree_on() -> None:
    rng = np.random.default_rng(1)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    source_from_world = np.eye(4)
    source_from_world[:3, :3] = turn
    # all from above: the mean of their own ups is far from the vertical, their horizons are not
    high = [c for c in dome(40, 3.0, np.zeros(3), 100.0, 64) if c.center[1] > 1 and c.center[0] > -1]
    poses = [c.world_to_camera @ np.linalg.inv(source_from_world) for c in high]
    up = upright_rotation(poses)[:3, :3] @ turn @ [0, 1, 0]
    np.testing.assert_allclose(up, [0, 1, 0], atol=1e-6)


def test_level_cameras_in_a_row_keep_their_up() -> None:
    poses = [look_at(np.array([x, 0, 5.0]), np.array([x, 0, 0]), 100.0, 64, 64).world_to_camera for x in (-1.0, 0, 1)]
    np.testing.assert_allclose(upright_rotation(poses)[:3, :3] @ [0, 1, 0], [0, 1, 0], atol=1e-9)
    np.testing.assert_allclose(upright_rotation(poses)[:3, :3] @ [0, 0, 1], [0, 0, 1], atol=1e-9)


def test_the_real_points(shared: Path) -> None:
    points = read_points(shared / "photos" / "skull" / "colmap_sparse_fullres")
    assert points is not None and len(points.positions) > 1000
    sample = np.loadtxt(shared / "photos" / "skull" / "points3D_sample.txt")
    for row in sample[:5]:
        assert np.abs(points.positions - row[:3]).max(axis=1).min() < 1e-4
