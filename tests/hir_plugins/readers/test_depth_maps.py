"""Depth maps beside photographs: their unit, confidence, lens and camera; what is wrong with them is a sentence."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hir_exporters.textures.image_files import write_png
from numpy.typing import NDArray
from PIL import Image

from hir_core.capture import Capture
from hir_core.capture.pixel_cache import PixelCache
from hir_core.errors import CaptureError
from hir_core.intake.reader_lookup import read_capture
from hir_core.plugins.manager import PluginManager
from hir_core.run.capture_store import fingerprint, restore_capture, save_capture

WIDTH, HEIGHT, FOCAL = 64, 48, 60.0
PLUGINS = PluginManager.discover()


def photograph(path: Path) -> None:
    write_png(path, np.full((HEIGHT, WIDTH, 3), 0.5, np.float32))


def store(path: Path, values: NDArray[Any], kind: type = np.uint16) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.asarray(values).astype(kind)).save(path)


def plane(width: int, height: int, coefficients: tuple[float, ...] = ()) -> NDArray[np.float64]:
    """Depth in metres of the plane z = 2 + x/2 in camera axes, at pixels of an image as taken with this k1."""
    x = ((np.arange(width) + 0.5) / width * WIDTH - WIDTH / 2) / FOCAL
    y = ((np.arange(height) + 0.5) / height * HEIGHT - HEIGHT / 2) / FOCAL
    taken_x, taken_y = np.meshgrid(x, y)
    ideal_x, ideal_y = taken_x.copy(), taken_y.copy()
    for _ in range(50):  # inverts the distortion
        scale = 1 + (coefficients[0] if coefficients else 0) * (ideal_x**2 + ideal_y**2)
        ideal_x, ideal_y = taken_x / scale, taken_y / scale
    return 2 / (1 - ideal_x / 2)


def transforms(folder: Path, depth: NDArray[Any] | None, frame: dict[str, Any] | None = None, **top: Any) -> Capture:
    """A capture of one photograph with a depth map."""
    photograph(folder / "images" / "a.png")
    entry: dict[str, Any] = {"file_path": "images/a.png", "transform_matrix": np.eye(4).tolist()}
    if depth is not None:
        store(folder / "depths" / "a.png", depth)
        entry["depth_file_path"] = "depths/a.png"
    lens = {"fl_x": FOCAL, "fl_y": FOCAL, "cx": WIDTH / 2, "cy": HEIGHT / 2, "w": WIDTH, "h": HEIGHT}
    document = {**lens, **top, "frames": [entry | (frame or {})]}
    (folder / "transforms.json").write_text(json.dumps(document))
    return read_capture(folder, "train", PLUGINS)


@pytest.mark.parametrize("factor", [1, 4])
def test_points_of_a_depth_map_lie_on_the_plane(factor: int, tmp_path: Path) -> None:
    """Through the camera of the depth map, whatever its resolution, in the world of the photographs."""
    depth = plane(WIDTH // factor, HEIGHT // factor)
    view = transforms(tmp_path, np.rint(depth * 1000)).views[0]
    found = view.measured_depth()
    assert found is not None and view.camera is not None
    camera, pixels = found
    assert (camera.width, camera.height) == (WIDTH // factor, HEIGHT // factor)
    np.testing.assert_allclose(pixels.depth, depth, atol=0.0005 + 1e-6)
    assert (pixels.confidence == 1).all()
    rows, columns = np.mgrid[: camera.height, : camera.width]
    corners = np.stack([columns.ravel(), rows.ravel()], axis=1) + 0.5
    origin, direction = camera.rays(corners)
    local = (direction @ camera.world_to_camera[:3, :3].T) / (direction @ camera.world_to_camera[2, :3])[:, None]
    points = local * pixels.depth.ravel()[:, None]
    np.testing.assert_allclose(points[:, 2], 2 + points[:, 0] / 2, atol=0.001)
    np.testing.assert_allclose(origin, np.broadcast_to(view.camera.center, origin.shape))


@pytest.mark.parametrize("model", ["radial", "fisheye"])
def test_the_lens_of_the_photograph_is_removed(model: str, tmp_path: Path) -> None:
    if model == "radial":
        capture = transforms(
            tmp_path, np.rint(plane(WIDTH, HEIGHT, (-0.2,)) * 10000), k1=-0.2, depth_unit_scale_factor=1e-4
        )
        cached = PixelCache().undistort(capture)
        for one, other in zip(
            capture.views[0].measured_depth() or (), cached.views[0].measured_depth() or (), strict=True
        ):
            for name in ("depth", "intrinsics"):
                if hasattr(one, name):
                    np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    else:
        # without coefficients the image radius is the angle
        x = ((np.arange(WIDTH) + 0.5) - WIDTH / 2) / FOCAL
        y = ((np.arange(HEIGHT) + 0.5) - HEIGHT / 2) / FOCAL
        grid_x, grid_y = np.meshgrid(x, y)
        radius = np.hypot(grid_x, grid_y)
        ideal = grid_x / np.maximum(radius, 1e-9) * np.tan(radius)
        capture = transforms(
            tmp_path, np.rint(2 / (1 - ideal / 2) * 10000), camera_model="OPENCV_FISHEYE", depth_unit_scale_factor=1e-4
        )
    camera, pixels = capture.views[0].measured_depth() or pytest.fail("no depth")
    columns = (np.arange(camera.width) + 0.5 - camera.intrinsics[0, 2]) / camera.intrinsics[0, 0]
    expected = np.broadcast_to(2 / (1 - columns / 2), pixels.depth.shape)
    known = pixels.depth > 0
    assert known.mean() > 0.8
    # the depth of the nearest pixel: half a pixel is 0.01
    np.testing.assert_allclose(pixels.depth[known], expected[known], atol=0.02)


def test_confidence_and_unknown_depths(tmp_path: Path) -> None:
    depth = np.full((HEIGHT, WIDTH), 1500)
    depth[0] = 0
    for levels, kind, expected in (
        ([0, 127, 255], np.uint8, [0, 127 / 255, 1]),
        ([0, 1, 2], np.uint8, [0, 0.5, 1]),
        ([0, 30000, 65535], np.uint16, [0, 30000 / 65535, 1]),
    ):
        rows = np.resize(np.array(levels), (HEIGHT, 1)) * np.ones((1, WIDTH))
        store(tmp_path / "confidence" / "a.png", rows, kind)
        view = transforms(tmp_path, depth, {"confidence_file_path": "confidence/a.png"}).views[0]
        _, pixels = view.measured_depth() or pytest.fail("no depth")
        np.testing.assert_allclose(pixels.confidence[3:6, 0], expected, atol=1e-6)
        assert (pixels.confidence[0] == 0).all() and (pixels.depth[0] == 0).all()
        low = np.arange(HEIGHT) % 3 == 0
        np.testing.assert_allclose(pixels.depth[~low], 1.5, rtol=1e-6)
        assert (pixels.depth[low] == 0).all()
        high = replace(view, depth=replace(view.depth, min_confidence=0.6))  # type: ignore[type-var]
        _, pixels = high.measured_depth() or pytest.fail("no depth")
        assert ((pixels.depth > 0).all(axis=1) == (np.arange(HEIGHT) % 3 == 2)).all()
        assert ((pixels.confidence > 0) == (pixels.depth > 0)).all()


def test_depths_move_with_the_world(tmp_path: Path) -> None:
    capture = transforms(tmp_path, np.full((HEIGHT, WIDTH), 1000))
    transform = np.diag([3.0, 3.0, 3.0, 1.0])
    transform[:3, 3] = 1, 2, 3
    camera, pixels = capture.transformed(transform).views[0].measured_depth() or pytest.fail("no depth")
    np.testing.assert_allclose(pixels.depth, 3.0, rtol=1e-6)
    _, depth = camera.project(
        (capture.cameras[0].center + capture.cameras[0].world_to_camera[2, :3]) @ transform[:3, :3] + [[1, 2, 3]]
    )
    np.testing.assert_allclose(depth, 3.0)


def test_a_run_knows_its_depth_maps(tmp_path: Path) -> None:
    """The fingerprint covers their bytes; a stored capture has their scale and least confidence."""
    capture = transforms(tmp_path, np.full((HEIGHT, WIDTH), 1000))
    before = fingerprint(capture)
    assert before == fingerprint(transforms(tmp_path, np.full((HEIGHT, WIDTH), 1000)))
    assert before != fingerprint(transforms(tmp_path, np.full((HEIGHT, WIDTH), 1001)))
    moved = capture.transformed(np.diag([2.0, 2.0, 2.0, 1.0]))
    moved = replace(moved, views=tuple(replace(v, depth=replace(v.depth, min_confidence=0.7)) for v in moved.views))
    save_capture(moved, tmp_path / "stage")
    restored = restore_capture(capture, tmp_path / "stage").views[0]
    assert restored.depth is not None and restored.depth.world_per_unit == pytest.approx(2)
    assert restored.depth.min_confidence == 0.7
    given_up = replace(capture, views=(replace(capture.views[0], depth=None),))
    save_capture(given_up, tmp_path / "stage")
    assert restore_capture(capture, tmp_path / "stage").views[0].depth is None


@pytest.mark.parametrize(
    ("frame", "top", "reason"),
    [
        ({"depth_file_path": "depths/none.png"}, {}, "none.png"),
        ({"depth_file_path": "../a.png"}, {}, "leads out of"),
        ({"depth_file_path": "images/a.png"}, {}, "no map of whole numbers"),
        ({"depth_file_path": "depths/wide.png"}, {}, "aspect ratio"),
        ({"confidence_file_path": "depths/wide.png"}, {}, "give them the same size"),
        ({"confidence_file_path": "images/a.png"}, {}, "no map of whole numbers"),
        ({}, {"depth_unit_scale_factor": 0}, "depth_unit_scale_factor is 0"),
        ({}, {"depth_unit_scale_factor": "mm"}, "depth_unit_scale_factor"),
    ],
)
def test_what_is_wrong_is_said(frame: dict[str, Any], top: dict[str, Any], reason: str, tmp_path: Path) -> None:
    store(tmp_path / "depths" / "wide.png", np.ones((HEIGHT, 2 * WIDTH)))
    with pytest.raises(CaptureError, match=reason):
        transforms(tmp_path, np.ones((HEIGHT, WIDTH)), frame, **top).views[0].measured_depth()


def test_polycam_has_millimetres_and_three_levels(tmp_path: Path) -> None:
    names = ("101", "102")
    for name in names:
        photograph(tmp_path / "keyframes" / "corrected_images" / f"{name}.png")
        pose = {f"t_{row}{column}": float(row == column) for row in range(3) for column in range(4)}
        lens = {"fx": FOCAL, "fy": FOCAL, "cx": WIDTH / 2, "cy": HEIGHT / 2, "width": WIDTH, "height": HEIGHT}
        cameras = tmp_path / "keyframes" / "corrected_cameras"
        cameras.mkdir(exist_ok=True)
        (cameras / f"{name}.json").write_text(json.dumps(pose | lens))
    levels = np.resize([0, 127, 255], (12, 16))
    store(tmp_path / "keyframes" / "depth" / "101.png", np.full((12, 16), 1250))
    store(tmp_path / "keyframes" / "confidence" / "101.png", levels, np.uint8)
    first, second = read_capture(tmp_path, "train", PLUGINS).views
    camera, pixels = first.measured_depth() or pytest.fail("no depth")
    assert (camera.width, camera.height) == (16, 12) and camera.intrinsics[0, 0] == FOCAL / 4
    np.testing.assert_allclose(pixels.depth, np.where(levels > 0, 1.25, 0), rtol=1e-6)
    np.testing.assert_allclose(pixels.confidence, levels / 255, atol=1e-6)
    assert second.depth is None and second.measured_depth() is None
