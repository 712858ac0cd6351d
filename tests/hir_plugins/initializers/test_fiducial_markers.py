"""Metres and the horizontal from printed markers, in photographs whose geometry is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hir_core.capture import Camera, Capture
from hir_core.config import load_config
from hir_core.errors import CaptureError, ConfigError
from hir_core.plugins.manager import PluginManager
from hir_core.stages.initialization import resolve_initializers
from hir_core.stages.settings_without_effect import check_settings_take_effect
from hir_core.testing.captures import StoredPixels
from hir_plugins.initializers.markers.fiducial_markers import FiducialMarkers
from hir_plugins.initializers.markers.marker_detection import find_dictionary
from hir_plugins.initializers.markers.marker_geometry import levelling_rotation
from hir_plugins.initializers.markers.marker_sheet import MarkerSheet
from hir_plugins.initializers.markers.marker_views import marker_capture
from hir_plugins.initializers.options import FiducialMarkersOptions
from tests.fixtures.silhouette_captures import look_at

SHEET = MarkerSheet(columns=3, rows=3, side=0.4, pitch=0.6)


def about_x(degrees: float) -> np.ndarray:
    a = np.radians(degrees)
    return np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])


def cameras(count: int = 12) -> list[Camera]:
    """480² from all around and above."""
    found = []
    for i in range(count):
        angle, height = 2.4 * i, 1.6 + 0.8 * np.sin(1.7 * i)
        found.append(look_at(np.array([3 * np.cos(angle), height, 3 * np.sin(angle)]), np.zeros(3), 600.0, 480, 480))
    return found


def photographs(sheet: MarkerSheet = SHEET, height: float = 0.0, turn: np.ndarray | None = None) -> Capture:
    return marker_capture(Path("made"), cameras(), sheet, height, turn)


@pytest.fixture(scope="module")
def on_sheet() -> Capture:
    return photographs()


def solved(capture: Capture, folder: Path, **options: object) -> tuple[Capture, dict[str, object]]:
    """The capture after the initializer, and its report. The sides are given as 0.02 m: a twentieth."""
    initializer = FiducialMarkers(FiducialMarkersOptions(**({"side": 0.02, "dictionary": "aruco_4x4"} | options)))  # type: ignore[arg-type]
    return initializer.initialize(capture, None, folder)[0], dict(initializer.report())


def scale_of(capture: Capture, before: Capture) -> float:
    """How much smaller the world has become, from the distances of cameras."""
    new, old = (np.array([c.center for c in each.cameras]) for each in (capture, before))
    return float(np.linalg.norm(new[1:] - new[0]) / np.linalg.norm(old[1:] - old[0]))


def test_the_world_is_scaled_to_metres(on_sheet: Capture, tmp_path: Path) -> None:
    found, report = solved(on_sheet, tmp_path)
    assert scale_of(found, on_sheet) == pytest.approx(0.05, rel=0.005)
    deviation = report["relative_deviation_of_sides"]
    assert 0 < deviation < 0.005
    assert report["scale_from"] == f"8 markers (aruco_4x4) of 0.02 m, whose sides differ by {deviation:.2%}"
    np.testing.assert_allclose(found.world_from_source[:3, :3], 0.05 * np.eye(3), atol=0.05 * 0.01)


@pytest.mark.parametrize(
    "dictionary",
    [
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("aruco_5x5", "aruco_6x6", "apriltag_25h9")),
        "apriltag_36h11",
    ],
)
def test_the_dictionary_is_found(tmp_path: Path, dictionary: str) -> None:
    capture = photographs(replace(SHEET, dictionary=dictionary))
    assert find_dictionary(capture.views) == dictionary
    assert scale_of(solved(capture, tmp_path, dictionary="auto")[0], capture) == pytest.approx(0.05, rel=0.005)


@pytest.mark.parametrize("degrees", [0.0, 12.0, -30.0])
def test_the_world_is_turned_until_the_sheet_is_horizontal(tmp_path: Path, degrees: float) -> None:
    turn = about_x(degrees)
    capture = photographs(turn=turn)
    found, report = solved(capture, tmp_path)
    rotation = found.world_from_source[:3, :3] / 0.05
    np.testing.assert_allclose(rotation @ turn @ [0, 1, 0], [0, 1, 0], atol=0.01)
    assert str(report["level"]).startswith("turned by")
    kept, report = solved(capture, tmp_path, level=False)
    np.testing.assert_allclose(kept.world_from_source[:3, :3], 0.05 * np.eye(3), atol=0.05 * 0.01)
    assert report["level"] == "kept: level is false"


def test_a_sheet_on_a_wall_does_not_turn_the_world(tmp_path: Path) -> None:
    capture = photographs(turn=about_x(70))
    found, report = solved(capture, tmp_path)
    assert str(report["level"]).startswith("kept: the markers' plane is")
    np.testing.assert_allclose(found.world_from_source[:3, :3], 0.05 * np.eye(3), atol=0.05 * 0.01)


def test_a_wrong_camera_is_left_out(on_sheet: Capture, tmp_path: Path) -> None:
    above = next(i for i, view in enumerate(on_sheet.views) if view.camera is not None and view.camera.center[1] > 1.0)
    views = list(on_sheet.views)
    camera = views[above].camera
    assert camera is not None
    pose = camera.world_to_camera.copy()
    pose[0, 3] += 0.2
    views[above] = replace(views[above], camera=replace(camera, world_to_camera=pose))
    found, _ = solved(replace(on_sheet, views=tuple(views)), tmp_path)
    np.testing.assert_allclose(np.linalg.norm(found.world_from_source[0, :3]), 0.05, rtol=0.005)


@pytest.mark.slow
def test_lens_distortion_is_removed_first(on_sheet: Capture, tmp_path: Path) -> None:
    """Photographs as a lens with strong distortion takes them."""
    import cv2

    coefficients = (-0.25, 0.08)
    views = []
    for view in on_sheet.views:
        camera, pixels = view.camera, view.pixels()
        assert camera is not None
        y, x = np.mgrid[: camera.height, : camera.width].astype(np.float64) + 0.5
        focal, middle = camera.intrinsics[0, 0], camera.intrinsics[:2, 2]
        taken = (np.stack([x, y], axis=-1) - middle) / focal
        ideal = taken
        for _ in range(100):
            squared = (ideal**2).sum(axis=-1, keepdims=True)
            ideal = taken / (1 + coefficients[0] * squared + coefficients[1] * squared**2)
        positions = (ideal * focal + middle - 0.5).astype(np.float32)
        color = cv2.remap(pixels.color_linear, positions[..., 0], positions[..., 1], cv2.INTER_CUBIC)
        read = StoredPixels(color.clip(0, 1), None)
        views.append(replace(view, read=read, mask=pixels.mask, distortion=(*coefficients, 0.0, 0.0)))
    found, _ = solved(replace(on_sheet, views=tuple(views)), tmp_path)
    assert scale_of(found, on_sheet) == pytest.approx(0.05, rel=0.005)


def test_what_gives_no_scale_is_refused(on_sheet: Capture, tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="no marker of any known dictionary"):
        solved(replace(on_sheet, views=on_sheet.views[:1]), tmp_path, dictionary="auto")
    with pytest.raises(CaptureError, match="no marker"):
        solved(replace(on_sheet, views=()), tmp_path, dictionary="auto")
    with pytest.raises(CaptureError, match="no marker of apriltag_36h11 is seen"):
        solved(on_sheet, tmp_path, dictionary="apriltag_36h11")
    for side in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ConfigError, match=r"fiducial_markers\.side"):
            solved(on_sheet, tmp_path, side=side)
    exchanged = [replace(a, camera=b.camera) for a, b in zip(on_sheet.views, on_sheet.views[3:], strict=False)]
    with pytest.raises(CaptureError, match="contradict"):
        solved(replace(on_sheet, views=tuple(exchanged)), tmp_path)


def test_a_number_that_lies_twice_in_a_photograph_is_not_used(on_sheet: Capture, tmp_path: Path) -> None:
    """The same sheet again, beside the first one."""
    views = []
    for view in on_sheet.views:
        camera, color = view.camera, view.pixels().color_linear
        assert camera is not None
        intrinsics = camera.intrinsics.copy()
        wide = replace(camera, intrinsics=intrinsics, width=2 * camera.width)
        views.append(replace(view, camera=wide, read=StoredPixels(np.concatenate([color, color], axis=1), None)))
    with pytest.warns(UserWarning, match="lie twice in one photograph"), pytest.raises(CaptureError):
        solved(replace(on_sheet, views=tuple(views)), tmp_path)


@pytest.mark.parametrize("front", [(0, 1, 0), (0.3, 0.8, -0.2), (0, -1, 0.0)])
def test_the_levelling_rotation_is_a_rotation_to_the_vertical(front: tuple[float, float, float]) -> None:
    unit = np.array(front) / np.linalg.norm(front)
    turn, degrees = levelling_rotation(unit)
    assert degrees == pytest.approx(np.degrees(np.arccos(unit[1])), abs=1e-6)
    np.testing.assert_allclose(turn[:3, :3] @ turn[:3, :3].T, np.eye(3), atol=1e-12)
    if unit[1] > -1:
        np.testing.assert_allclose(turn[:3, :3] @ unit, [0, 1, 0], atol=1e-12)


def test_an_automatic_chain_contains_them_where_their_side_is_given(on_sheet: Capture) -> None:
    plugins = PluginManager.discover()
    without = load_config(plugins)
    given = load_config(plugins, assignments=["initializer.fiducial_markers.side=0.02"])
    assert "fiducial_markers" not in resolve_initializers(on_sheet, without, plugins)
    assert resolve_initializers(on_sheet, given, plugins) == ("colmap", "fiducial_markers", "visual_hull")
    ignored = load_config(
        plugins, assignments=["initializer.fiducial_markers.side=0.02", 'initializers=["visual_hull"]']
    )
    with pytest.raises(ConfigError, match=r"fiducial_markers\.side has no effect"):
        check_settings_take_effect(ignored, plugins)
