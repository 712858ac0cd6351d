"""The axes, sizes and lights of transforms.json files, and what a broken one says."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hir_exporters.conventions import direction_to_latlong_uv
from PIL import Image

from hir_core.errors import CaptureError
from hir_core.plugins import NoOptions
from hir_plugins.readers.transforms_json import TransformsJsonReader

READER = TransformsJsonReader(NoOptions())
# looks from (0, -4, 1) along +Y with z up, in the file's axes: Blender's camera x stays x, y becomes z, z becomes -y
POSE = [[1, 0, 0, 0.0], [0, 0, -1, -4.0], [0, 1, 0, 1.0], [0, 0, 0, 1]]


def write(folder: Path, name: str = "transforms.json", **content: Any) -> Path:
    table = {"fl_x": 80.0, "frames": [{"file_path": "images/a.png", "transform_matrix": POSE}]} | content
    (folder / name).write_text(json.dumps(table))
    return folder


def test_a_point_lands_on_its_pixel(picture: Path) -> None:
    camera = READER.read(write(picture)).cameras[0]
    # file axes: right of the axis by 0.4, above it by 0.55, 4 in front; ours: (x, z, -y)
    pixels, depth = camera.project(np.array([[0.4, 1.55, 0.0]]))
    np.testing.assert_allclose(pixels, [[32 + 80 * 0.4 / 4, 24 - 80 * 0.55 / 4]], atol=1e-12)
    np.testing.assert_allclose(depth, [4.0], atol=1e-12)
    np.testing.assert_allclose(camera.center, [0, 1, 4], atol=1e-12)


def test_that_pixel_is_the_bright_one(picture: Path) -> None:
    view = READER.read(write(picture)).views[0]
    bright = np.argwhere(view.pixels().color_linear[..., 0] > 0.5)
    assert bright.tolist() == [[12, 40]]
    assert view.camera is not None
    pixel, _ = view.camera.project(np.array([[0.425, 1.575, 0.0]]))
    np.testing.assert_allclose(pixel, [[40.5, 12.5]], atol=1e-9)


def test_world_from_source_maps_the_files_axes(picture: Path) -> None:
    capture = READER.read(write(picture))
    np.testing.assert_allclose(capture.world_from_source @ [1, 2, 3, 1], [1, 3, -2, 1])


@pytest.mark.parametrize(
    "direction", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0, 0), (0, -1, 0), (0.3, -0.5, 0.2), (-0.6, 0.1, -0.7)]
)
def test_environment_directions_follow_the_files_convention(picture: Path, direction: tuple[float, ...]) -> None:
    environment = READER.read(write(picture, environment={"file_path": "sky.hdr", "strength": 0.4})).environment
    assert environment is not None and environment.strength == 0.4
    x, y, z = np.array(direction) / np.linalg.norm(direction)
    # shared/DATA.md: u = 0.5 - atan2(y, x)/2π, v = 1 - acos(z)/π from the bottom row
    expected = np.array([(0.5 - np.arctan2(y, x) / (2 * np.pi)) % 1.0, np.arccos(z) / np.pi])
    ours = environment.source_from_environment.T @ np.array([x, y, z])
    uv = direction_to_latlong_uv(ours)
    np.testing.assert_allclose(uv[1], expected[1], atol=1e-12)
    if abs(z) < 1:  # the poles have no longitude
        np.testing.assert_allclose(uv[0], expected[0], atol=1e-12)
    assert np.linalg.det(environment.source_from_environment) == 1


def test_the_field_of_view_gives_the_focal_length(picture: Path) -> None:
    write(picture, fl_x=None, camera_angle_x=2 * np.arctan(0.5 * 64 / 80))
    np.testing.assert_allclose(READER.read(picture).cameras[0].intrinsics, [[80, 0, 32], [0, 80, 24], [0, 0, 1]])


def test_intrinsics_follow_a_smaller_image(picture: Path) -> None:
    write(picture, fl_x=160.0, fl_y=164.0, cx=60.0, cy=50.0, w=128, h=96)
    np.testing.assert_allclose(READER.read(picture).cameras[0].intrinsics, [[80, 0, 30], [0, 82, 25], [0, 0, 1]])


def test_a_cropped_image_is_refused(picture: Path) -> None:
    with pytest.raises(CaptureError, match="64×48"):
        READER.read(write(picture, w=128, h=128))


def test_a_training_read_opens_no_other_split(picture: Path) -> None:
    write(picture, "transforms_train.json")
    (picture / "transforms_test.json").write_text("not json")
    (picture / "transforms_relight_0.json").write_text("not json")
    assert READER.splits(picture) == ["train", "test", "relight_0"]
    assert [v.name for v in READER.read(picture).views] == ["a"]
    with pytest.raises(CaptureError, match=r"transforms_test\.json is not valid JSON"):
        READER.read(picture, "test")
    with pytest.raises(CaptureError, match="no split 'val'"):
        READER.read(picture, "val")


def test_filename_lists_make_splits(picture: Path) -> None:
    Image.new("RGB", (64, 48)).save(picture / "images" / "b.png")
    frames = [{"file_path": f"images/{n}.png", "transform_matrix": POSE} for n in "ab"]
    write(picture, frames=frames, train_filenames=["images/a.png"], test_filenames=["images/b.png"])
    assert READER.splits(picture) == ["train", "test"]
    assert [v.name for v in READER.read(picture, "test").views] == ["b"]
    assert [v.name for v in READER.read(picture).views] == ["a"]


def test_photographs_that_are_listed_for_tests_are_not_for_the_fit(picture: Path) -> None:
    """A file without `train_filenames`: all other photographs, not all of them."""
    Image.new("RGB", (64, 48)).save(picture / "images" / "b.png")
    frames = [{"file_path": f"images/{n}.png", "transform_matrix": POSE} for n in "ab"]
    write(picture, frames=frames, test_filenames=["images/b.png"])
    assert READER.splits(picture) == ["train", "test"]
    assert [v.name for v in READER.read(picture).views] == ["a"]
    assert [v.name for v in READER.read(picture, "test").views] == ["b"]
    write(picture, frames=frames, val_filenames=["images/a.png"], test_filenames=["images/b.png"])
    with pytest.raises(CaptureError, match="lists no frame of the split 'train'; name its photographs in the list"):
        READER.read(picture)


def test_float32_matrices_become_rotations(picture: Path) -> None:
    rotation = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    pose = np.eye(4)
    pose[:3, :3] = rotation.astype(np.float32) * 2  # an object's scale does not change a camera
    write(picture, frames=[{"file_path": "images/a", "transform_matrix": pose.tolist()}])
    turned = READER.read(picture).cameras[0].world_to_camera[:3, :3]
    np.testing.assert_allclose(turned @ turned.T, np.eye(3), atol=1e-14)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ({"frames": []}, "no frames"),
        ({"frames": [{"file_path": "images/a.png"}]}, "frame 0"),
        ({"frames": [{"transform_matrix": POSE}]}, "file_path"),
        ({"frames": [{"file_path": "images/zz", "transform_matrix": POSE}]}, "'images/zz'"),
        ({"frames": [{"file_path": "../secret.png", "transform_matrix": POSE}]}, "leads out"),
        ({"frames": [{"file_path": "/etc/hosts", "transform_matrix": POSE}]}, "absolute"),
        ({"frames": [{"file_path": "C:\\a.png", "transform_matrix": POSE}]}, "absolute"),
        ({"frames": [{"file_path": "images/a.png", "transform_matrix": [[float("nan")] * 4] * 4}]}, "NaN"),
        ({"frames": [{"file_path": "images/a.png", "transform_matrix": [[1, 0], [0]]}]}, "matrix"),
        ({"frames": [{"file_path": "images/a.png", "transform_matrix": np.diag([1, 1, -1, 1]).tolist()}]}, "mirrored"),
        ({"frames": [{"file_path": "images/a.png", "transform_matrix": np.zeros((4, 4)).tolist()}]}, "length"),
        ({"fl_x": "80"}, "'fl_x'"),
        ({"fl_x": float("inf")}, "'fl_x'"),
        ({"fl_x": None}, "camera_angle_x"),
        ({"fl_x": -3}, "focal length -3"),
        ({"camera_model": "EQUIRECTANGULAR"}, "EQUIRECTANGULAR"),
        ({"k1": -50.0, "k2": 3.0}, "fold"),
        ({"environment": {"file_path": "../../sky.hdr"}}, "leads out"),
        ({"environment": "sky.hdr"}, "environment"),
    ],
)
def test_a_broken_file_is_one_clear_error(picture: Path, content: dict[str, Any], says: str) -> None:
    with pytest.raises(CaptureError, match=says) as caught:
        READER.read(write(picture, **content))
    assert "transforms.json" in str(caught.value) and "\n" not in str(caught.value)


def test_a_link_out_of_the_capture_is_refused(picture: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    outside = tmp_path_factory.mktemp("outside") / "x.png"
    Image.new("RGB", (64, 48)).save(outside)
    (picture / "images" / "link.png").symlink_to(outside)
    with pytest.raises(CaptureError, match="leads out"):
        READER.read(write(picture, frames=[{"file_path": "images/link.png", "transform_matrix": POSE}]))


def test_matches_by_name_only(tmp_path: Path) -> None:
    assert not READER.matches(tmp_path) and not READER.matches(tmp_path / "missing")
    (tmp_path / "transforms.json").write_text("{")
    assert READER.matches(tmp_path) and READER.matches(tmp_path / "transforms.json")


def test_distortion_is_removed_when_pixels_are_read(picture: Path) -> None:
    # a grid of dots drawn through the lens must come out where the pinhole camera projects its points
    k1, k2, p1, p2 = -0.2, 0.05, 0.002, -0.003
    local = np.array([[x, y, 1.0] for x in (-0.25, 0.0, 0.2) for y in (-0.2, 0.0, 0.15)])
    x, y = local[:, 0], local[:, 1]
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2 * r2
    u = 80 * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + 32
    v = 80 * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + 24
    rows, columns = np.mgrid[0:48, 0:64] + 0.5
    dots = sum(np.exp(-((columns - a) ** 2 + (rows - b) ** 2) / 4) for a, b in zip(u, v, strict=True))
    Image.fromarray(np.rint(np.clip(dots, 0, 1) * 250).astype(np.uint8)).save(picture / "images" / "a.png")
    view = READER.read(write(picture, k1=k1, k2=k2, p1=p1, p2=p2)).views[0]
    camera = view.camera
    assert camera is not None and camera.distortion == ()
    world_from_camera = np.linalg.inv(camera.world_to_camera)
    expected, _ = camera.project(local @ world_from_camera[:3, :3].T + world_from_camera[:3, 3])
    image = view.pixels().color_linear[..., 0]
    for px, py in expected:
        weights = image * (np.hypot(columns - px, rows - py) < 4)
        found = np.array([(weights * columns).sum(), (weights * rows).sum()]) / weights.sum()
        np.testing.assert_allclose(found, [px, py], atol=0.05)


def test_fisheye_angles(picture: Path) -> None:
    view = READER.read(write(picture, camera_model="OPENCV_FISHEYE", k1=0.02, k2=-0.01)).views[0]
    lens = view.read.lens  # type: ignore[attr-defined]
    angle = 0.3
    fx, _, cx, cy = lens.pinhole
    distorted = lens.distort(np.array([[cx + fx * np.tan(angle), cy]]))
    np.testing.assert_allclose(distorted, [[32 + 80 * (angle + 0.02 * angle**3 - 0.01 * angle**5), 24]], atol=1e-9)


def test_views_can_be_pickled(picture: Path) -> None:
    capture = READER.read(write(picture, k1=0.1))
    again = pickle.loads(pickle.dumps(capture))
    np.testing.assert_array_equal(again.views[0].pixels().color_linear, capture.views[0].pixels().color_linear)


def test_the_shared_captures_read(shared: Path) -> None:
    for name, train, size in (("spot", 80, 512), ("avocado", 80, 512), ("chair", 50, 800)):
        capture = READER.read(shared / "captures" / name)
        assert len(capture.views) == train and capture.cameras[0].width == size
        pixels = capture.views[0].pixels()
        assert pixels.mask is not None and 0.02 < pixels.mask.mean() < 0.6
