"""Cameras that are a little wrong, refined from masks and features, against those of the pictures."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hir_core.capture import Array, Camera, Capture, Pixels
from hir_core.errors import CaptureError
from hir_plugins.initializers.hull.object_box import empty_hull_error
from hir_plugins.initializers.options import CameraRefinementOptions, ColmapOptions
from hir_plugins.initializers.plugin import hir_suggest_initializers
from hir_plugins.initializers.refinement import camera_refinement
from hir_plugins.initializers.refinement.adjusted_cameras import AdjustedBundle
from hir_plugins.initializers.refinement.camera_alignment import aligned_cameras, camera_motion
from hir_plugins.initializers.refinement.camera_refinement import CameraRefinement
from hir_plugins.initializers.refinement.outline_points import sample_with_slope
from hir_plugins.initializers.refinement.rotation_vectors import rotation_of_vector, vector_of_rotation
from hir_plugins.initializers.sfm.bundle_adjustment import Track, adjust_bundle, track_errors
from hir_plugins.initializers.sfm.sfm_images import write_images
from tests.fixtures.silhouette_captures import StoredPixels, dome, hits_boxes, hits_sphere, make_view, shape_capture
from tests.hir_plugins.initializers.test_colmap import cameras_on_an_arc, room

SIDE = 96
SURFACE = np.random.default_rng(5).uniform(-0.6, 0.6, (200, 3))
"""Points in the object."""


def shape(origins: Array, directions: Array) -> NDArray[np.bool_]:
    """Three bars of different lengths and a ball: no silhouette is that of another direction."""
    bars = np.array(
        [
            [[-0.7, -0.25, -0.2], [0.6, 0.15, 0.2]],
            [[0.2, -0.2, -0.2], [0.6, 0.7, 0.1]],
            [[-0.6, -0.15, -0.1], [-0.3, 0.1, 0.75]],
        ]
    )
    return hits_boxes(bars)(origins, directions) | hits_sphere(np.array([-0.45, 0.3, -0.1]), 0.3)(origins, directions)


@pytest.fixture(scope="module")
def true_capture() -> Capture:
    return shape_capture(dome(20, 3.0, np.zeros(3), 150.0, SIDE), shape)


def moved(camera: Camera, rng: np.random.Generator, size: float) -> Camera:
    """The camera turned by `size` radians, and moved by `size` of its distance from the origin, both at random."""
    turn, move = (v / np.linalg.norm(v) * size for v in rng.normal(size=(2, 3)))
    pose = np.eye(4)
    pose[:3, :3] = rotation_of_vector(turn) @ camera.world_to_camera[:3, :3]
    center = camera.center + move * np.linalg.norm(camera.center)
    pose[:3, 3] = -pose[:3, :3] @ center
    return replace(camera, world_to_camera=pose)


def with_cameras(capture: Capture, cameras: Sequence[Camera]) -> Capture:
    return replace(capture, views=tuple(replace(v, camera=c) for v, c in zip(capture.views, cameras, strict=True)))


def slightly_wrong(capture: Capture, seed: int = 3, size: float = 0.012) -> Capture:
    """Two cameras are three times as wrong as the others."""
    rng = np.random.default_rng(seed)
    cameras = [moved(c, rng, size * (3 if i in (4, 11) else 1)) for i, c in enumerate(capture.cameras)]
    return with_cameras(capture, cameras)


def pixel_errors(cameras: Sequence[Camera], true: Sequence[Camera], points: Array = SURFACE) -> Array:
    """Of each camera (V,): root mean square distance in the image between where it and the true one see the object."""
    return np.array(
        [
            np.sqrt(((a.project(points)[0] - b.project(points)[0]) ** 2).sum(axis=1).mean())
            for a, b in zip(cameras, true, strict=True)
        ]
    )


def refined(capture: Capture, folder: Path, **options: object) -> tuple[Capture, CameraRefinement, list[str]]:
    initializer = CameraRefinement(CameraRefinementOptions(threads=1, **options))  # type: ignore[arg-type]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result, scene = initializer.initialize(capture, None, folder)
    assert scene is None
    return result, initializer, [str(w.message) for w in caught if w.category is UserWarning]


@pytest.mark.slow
def test_wrong_cameras_come_back_from_silhouettes(true_capture: Capture, tmp_path: Path) -> None:
    wrong = slightly_wrong(true_capture)
    result, initializer, said = refined(wrong, tmp_path, method="silhouettes", rounds=3)
    before, after = (pixel_errors(c.cameras, true_capture.cameras) for c in (wrong, result))
    assert np.median(after) < 0.4 * np.median(before), (before, after)
    assert after.max() < 0.3 * before.max()
    report = initializer.report()
    assert report["cameras"] == "refined by outlines"
    agreement, final = report["agreement"], report["agreement_refined"]
    assert isinstance(agreement, dict) and isinstance(final, dict)
    assert final["median"] > agreement["median"] + 0.05 and final["gap_pixels"] < 0.4 < agreement["gap_pixels"]
    assert len(said) == 1 and "the given cameras were a little wrong" in said[0] and "when=never" in said[0]
    # everything but the poses stays
    for old, new in zip(wrong.views, result.views, strict=True):
        assert new == replace(old, camera=new.camera) and new.camera is not None
        assert np.array_equal(new.camera.intrinsics, old.camera.intrinsics)  # type: ignore[union-attr]
        np.testing.assert_allclose(
            new.camera.world_to_camera[:3, :3] @ new.camera.world_to_camera[:3, :3].T, np.eye(3), atol=1e-12
        )


def test_right_cameras_are_not_touched(true_capture: Capture, tmp_path: Path) -> None:
    result, initializer, said = refined(true_capture, tmp_path)
    assert result is true_capture and not said
    assert initializer.report()["cameras"] == "kept: masks and cameras agree"
    assert not list(tmp_path.iterdir()), "no features are extracted to find that all is well"


def test_it_can_be_switched_off(true_capture: Capture, tmp_path: Path) -> None:
    wrong = slightly_wrong(true_capture)
    result, initializer, said = refined(wrong, tmp_path, when="never")
    assert result is wrong and not said and initializer.report() == {"cameras": "kept: when is never"}


@pytest.mark.slow
def test_wrong_masks_are_not_explained_by_cameras(true_capture: Capture, tmp_path: Path) -> None:
    """A random half of each mask is missing: cameras cannot mend that, and one sentence says so."""
    rng = np.random.default_rng(1)
    rows, columns = np.mgrid[0:SIDE, 0:SIDE] - SIDE / 2
    views = []
    for view in true_capture.views:
        angle = rng.uniform(0, 2 * np.pi)
        half = (rows * np.sin(angle) + columns * np.cos(angle) > -4).astype(np.float32)
        pixels = view.read()
        assert pixels.mask is not None
        views.append(replace(view, read=StoredPixels(replace(pixels, mask=pixels.mask * half))))
    broken = replace(true_capture, views=tuple(views))
    result, initializer, said = refined(broken, tmp_path, method="silhouettes", rounds=2)
    assert result is broken
    assert initializer.report()["cameras"] == "kept: refined ones are not better"
    assert len(said) == 1 and "hir check" in said[0] and "known_cameras=solve" in said[0]


class BrokenLater:
    """Reads a photograph a few times, then raises: a file that was removed while the run reads it."""

    def __init__(self, read: Callable[[], Pixels], times: int) -> None:
        self.read, self.left = read, times

    def __call__(self) -> Pixels:
        self.left -= 1
        if self.left < 0:
            raise CaptureError("photo.png cannot be decoded; replace the file")
        return self.read()


def test_a_photograph_that_cannot_be_decoded_is_an_error(true_capture: Capture, tmp_path: Path) -> None:
    """It is not reported as cameras that were kept."""
    wrong = slightly_wrong(true_capture)
    first, *others = wrong.views
    broken = replace(wrong, views=(replace(first, read=BrokenLater(first.read, 2)), *others))
    with pytest.raises(CaptureError, match=r"photo\.png cannot be decoded"):
        refined(broken, tmp_path, method="bundle_adjustment")


def test_masks_without_a_common_point_keep_the_cameras(true_capture: Capture, tmp_path: Path) -> None:
    """The next initializer says so; the report gives the reason."""
    rng = np.random.default_rng(4)
    astray = with_cameras(true_capture, [moved(c, rng, 0.5) for c in true_capture.cameras])
    result, initializer, said = refined(astray, tmp_path)
    assert result is astray and not said
    assert str(initializer.report()["cameras"]).startswith("kept: no point lies inside all masks")


def test_a_candidate_with_an_empty_hull_is_not_better(
    true_capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wrong, rng = slightly_wrong(true_capture), np.random.default_rng(4)
    astray = tuple(moved(c, rng, 0.5) for c in true_capture.cameras)
    bundle = AdjustedBundle(astray, len(astray), 500, 100, 1.0, 0.1, 1.0)
    monkeypatch.setattr(camera_refinement, "adjusted_bundle", lambda *arguments: bundle)
    result, initializer, said = refined(wrong, tmp_path, method="bundle_adjustment")
    assert bundle.better and result is wrong and initializer.report()["cameras"] == "kept: refined ones are not better"
    assert len(said) == 1 and "the given ones are kept" in said[0]


def test_a_hull_that_becomes_empty_ends_the_outlines(
    true_capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def empty(*arguments: object) -> None:
        raise empty_hull_error()

    monkeypatch.setattr(camera_refinement, "held_out_agreement", empty)
    wrong = slightly_wrong(true_capture)
    result, initializer, said = refined(wrong, tmp_path, method="silhouettes")
    assert result is wrong and initializer.report()["cameras"] == "kept: refined ones are not better"
    assert "no point lies inside all masks" in str(initializer.report()["outlines"]) and len(said) == 1


def test_few_photographs_keep_their_cameras(true_capture: Capture, tmp_path: Path) -> None:
    few = slightly_wrong(replace(true_capture, views=true_capture.views[:11]))
    result, initializer, said = refined(few, tmp_path)
    assert result is few and not said and "11 photographs" in str(initializer.report()["cameras"])
    result, _, said = refined(few, tmp_path, when="always")
    assert result is few and len(said) == 1 and "needs masks of 12 photographs" in said[0]


def test_alignment_undoes_a_similarity(true_capture: Capture) -> None:
    """Unit, origin and axes of the user stay, though one camera is far off."""
    cameras = true_capture.cameras
    similarity = np.eye(4)
    similarity[:3, :3] = 1.7 * rotation_of_vector(np.array([0.3, -0.2, 0.5]))
    similarity[:3, 3] = [4, -2, 1]
    elsewhere = [c.transformed(similarity) for c in cameras]
    back = aligned_cameras(elsewhere, cameras, np.zeros(3))
    assert camera_motion(back, cameras, np.zeros(3)).degrees.max() < 1e-5
    assert camera_motion(back, cameras, np.zeros(3)).percent.max() < 1e-6
    one_off = [moved(c, np.random.default_rng(0), 0.2) if i == 7 else c for i, c in enumerate(elsewhere)]
    motion = camera_motion(aligned_cameras(one_off, cameras, np.zeros(3)), cameras, np.zeros(3))
    assert np.delete(motion.percent, 7).max() < 1e-3


def test_rotation_vectors_invert() -> None:
    vector = np.array([0.2, -0.7, 0.1])
    np.testing.assert_allclose(vector_of_rotation(rotation_of_vector(vector)), vector, atol=1e-12)
    np.testing.assert_allclose(rotation_of_vector(np.array([0, 0, np.pi / 2])) @ [1, 0, 0], [0, 1, 0], atol=1e-12)


def test_the_slope_of_a_sampled_plane_is_exact() -> None:
    rows, columns = np.mgrid[0:20, 0:30] + 0.5
    at = np.random.default_rng(0).uniform(2, 17, (50, 2))
    value, slope = sample_with_slope(3 * columns - 2 * rows, at)
    np.testing.assert_allclose(value, 3 * at[:, 0] - 2 * at[:, 1], atol=1e-9)
    np.testing.assert_allclose(slope, np.broadcast_to([3.0, -2.0], slope.shape), atol=1e-9)


def test_errors_of_tracks_are_in_pixels(true_capture: Capture) -> None:
    cameras = true_capture.cameras[:5]
    pixels = np.array([c.project(np.array([[0.1, 0.2, 0.3]]))[0][0] for c in cameras])
    exact = Track(np.arange(5), pixels)
    assert track_errors([exact], cameras)[0] < 1e-9
    one_off = Track(np.arange(5), pixels + np.array([[2.0, 0]] + [[0, 0]] * 4))
    assert 0.5 < track_errors([one_off], cameras)[0] < 2 / np.sqrt(5)


@pytest.fixture(scope="module")
def arc() -> tuple[Capture, list[Camera]]:
    cameras = cameras_on_an_arc(7)
    views = [make_view(f"{i}", c, np.ones((240, 320), np.float32), room(c, 0)) for i, c in enumerate(cameras)]
    no_masks = [replace(v, read=StoredPixels(replace(v.read(), mask=None))) for v in views]
    return Capture(Path("made-in-memory"), tuple(no_masks)), cameras


def test_bundle_adjustment_starts_at_given_poses(arc: tuple[Capture, list[Camera]], tmp_path: Path) -> None:
    capture, true = arc
    rng = np.random.default_rng(2)
    given = [moved(c, rng, 0.006) for c in true]
    wrong = with_cameras(capture, given)
    images, _ = write_images(wrong.views, tmp_path, 1600, known=True)
    options = ColmapOptions(threads=1, max_features=2000)
    adjusted = adjust_bundle(images, given, False, tmp_path, options, refine_focal=False)
    assert adjusted is not None and adjusted.adjusted == len(true) and len(adjusted.held_out) > 20
    before, after = (np.median(track_errors(adjusted.held_out, c)) for c in (given, adjusted.cameras))
    assert after < 0.1 * before, (before, after)
    # the world is the one that moves the cameras least: compared in the world of the truth
    back = aligned_cameras(adjusted.cameras, true, np.zeros(3))
    assert np.median(pixel_errors(back, true)) < 0.3 * np.median(pixel_errors(given, true))
    assert all(np.array_equal(a.intrinsics, b.intrinsics) for a, b in zip(adjusted.cameras, given, strict=True))


@pytest.mark.parametrize("drop", [lambda v: replace(v, camera=None), lambda v: replace(v, read=no_mask(v.read))])
def test_it_is_suggested_where_there_are_cameras_and_masks(true_capture: Capture, drop: Callable) -> None:  # type: ignore[type-arg]
    assert hir_suggest_initializers(true_capture) == ["camera_refinement", "visual_hull"]
    changed = replace(true_capture, views=tuple(drop(v) for v in true_capture.views))
    assert hir_suggest_initializers(changed) == ["colmap", "visual_hull"]


def no_mask(read: Callable) -> StoredPixels:  # type: ignore[type-arg]
    return StoredPixels(replace(read(), mask=None))
