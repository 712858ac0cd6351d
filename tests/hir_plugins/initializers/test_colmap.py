"""Cameras from photographs alone, against the cameras that the pictures were made with."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from numpy.typing import NDArray

from hir_core.capture import Array, Camera, Capture, View
from hir_core.errors import CaptureError, ConfigError
from hir_core.plugins import NoOptions
from hir_plugins.initializers.options import ColmapOptions
from hir_plugins.initializers.sfm.colmap import Colmap
from hir_plugins.initializers.sfm.feature_matching import verification_options
from hir_plugins.initializers.sfm.structure_from_motion import attempts
from hir_plugins.readers.photos import PhotosReader
from tests.fixtures.silhouette_captures import StoredPixels, coverage, hits_boxes, look_at, make_view


def room(camera: Camera, seed: int) -> NDArray[np.float32]:
    """A picture of the inside of a cube, with a smaller cube in it, both painted with noise."""
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
    origins, directions = camera.rays(np.stack([columns, rows], axis=-1).reshape(-1, 2))
    inverse = 1 / directions
    far = np.maximum((-3 - origins) * inverse, (3 - origins) * inverse).min(axis=1)
    a, b = (-0.6 - origins) * inverse, (0.6 - origins) * inverse
    near, leave = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
    hit = near < leave
    points = origins + np.where(hit, near, far)[:, None] * directions
    rng = np.random.default_rng(seed)
    value = np.zeros(len(points))
    for cells in (4, 9, 21):
        lattice = rng.uniform(size=(64, 64, 64))
        p = (points + 4) * np.where(hit, 3, 1)[:, None] * cells / 4
        low = np.floor(p).astype(int)
        f = p - low
        for corner in np.ndindex(2, 2, 2):
            weight = np.abs(1 - np.array(corner) - f).prod(axis=1)
            value += weight * lattice[tuple(((low + corner) % 64).T)] / 3
    color = np.repeat(np.clip((value - 0.25) * 2, 0, 1)[:, None], 3, axis=1)
    return color.reshape(camera.height, camera.width, 3).astype(np.float32)


def cameras_on_an_arc(count: int) -> list[Camera]:
    angles = np.linspace(-0.5, 0.5, count)
    positions = [2.5 * np.array([np.sin(t), 0.25 + 0.1 * np.cos(5 * t), np.cos(t)]) for t in angles]
    return [look_at(p, np.zeros(3), 300.0, 320, 240) for p in positions]


def aligned(found: list[Array], true: list[Array]) -> tuple[Array, Array]:
    """Errors of rotation in degrees and of position relative to the true cameras' extent, after the best similarity."""
    a, b = np.array(found), np.array(true)
    center_a, center_b = (np.array([-p[:3, :3].T @ p[:3, 3] for p in poses]) for poses in (a, b))
    # the mean rotation between the two worlds is what the cameras' rotations say
    u, _, vt = np.linalg.svd(sum(q[:3, :3].T @ p[:3, :3] for p, q in zip(a, b, strict=True)))
    turn = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    ca, cb = center_a - center_a.mean(axis=0), center_b - center_b.mean(axis=0)
    scale = (cb * (ca @ turn.T)).sum() / (ca**2).sum()
    positions = np.linalg.norm(scale * ca @ turn.T - cb, axis=1) / np.linalg.norm(cb, axis=1).max()
    cosines = [(np.trace(p[:3, :3] @ turn.T @ q[:3, :3].T) - 1) / 2 for p, q in zip(a, b, strict=True)]
    return np.degrees(np.arccos(np.clip(cosines, -1, 1))), positions


@pytest.fixture(scope="module")
def arc() -> tuple[Capture, list[Camera]]:
    cameras = cameras_on_an_arc(8)
    views = [
        replace(make_view(f"{i}", c, np.ones((240, 320), np.float32), room(c, 0)), camera=None)
        for i, c in enumerate(cameras)
    ]
    no_masks = [replace(v, read=StoredPixels(replace(v.read(), mask=None))) for v in views]
    return Capture(Path("made-in-memory"), tuple(no_masks)), cameras


def test_cameras_are_found(arc: tuple[Capture, list[Camera]], tmp_path: Path) -> None:
    capture, true = arc
    solved, scene = Colmap(ColmapOptions(threads=1, focal_length=310.0)).initialize(capture, None, tmp_path)
    assert scene is None
    rotations, positions = aligned([c.world_to_camera for c in solved.cameras], [c.world_to_camera for c in true])
    assert rotations.max() < 0.3 and positions.max() < 0.02
    assert all(abs(c.intrinsics[0, 0] - 300) < 6 for c in solved.cameras)
    # up-right: the cameras stood level, and the object is at the origin
    for camera, known in zip(solved.cameras, true, strict=True):
        up = camera.world_to_camera[:3, :3] @ [0, 1, 0]
        np.testing.assert_allclose(up, known.world_to_camera[:3, :3] @ [0, 1, 0], atol=0.03)
    assert solved.points is not None and len(solved.points.positions) > 100
    pixels, depth = solved.cameras[0].project(np.zeros((1, 3)))
    assert depth[0] > 0 and np.abs(pixels[0] - [160, 120]).max() < 80
    # the record of the world leads from COLMAP's model to ours
    assert (tmp_path / "attempt-1" / "database.db").is_file()
    assert abs(np.linalg.det(solved.world_from_source)) > 0


def test_a_second_run_continues_the_first(arc: tuple[Capture, list[Camera]], tmp_path: Path) -> None:
    few = replace(arc[0], views=arc[0].views[2:6])
    options = ColmapOptions(threads=1, focal_length=310.0, retry=False)
    first, _ = Colmap(options).initialize(few, None, tmp_path)
    written_ns = (tmp_path / "images" / "00000.jpg").stat().st_mtime_ns
    second, _ = Colmap(options).initialize(few, None, tmp_path)
    assert (tmp_path / "images" / "00000.jpg").stat().st_mtime_ns == written_ns
    for a, b in zip(first.cameras, second.cameras, strict=True):
        np.testing.assert_allclose(a.world_to_camera, b.world_to_camera, atol=1e-3)


def test_each_pair_has_its_own_random_trials() -> None:
    """The matches of a pair in a resumed run must not depend on the pairs that it skips."""
    rng = np.random.default_rng(0)
    camera = pycolmap.Camera.create_from_model_name(1, "PINHOLE", 300.0, 320, 240)
    camera.has_prior_focal_length = True
    points = rng.uniform(-1, 1, (60, 3)) + np.array([0, 0, 4])
    turned = look_at(np.array([1.0, 0, 0]), np.array([0.0, 0, 4]), 300.0, 320, 240).project(points)[0]
    pixels = [300 * points[:, :2] / points[:, 2:] + [160, 120], turned]
    # a pixel of noise, and half of the matches are wrong: the trials decide which ones count
    a, b = (np.vstack([p + rng.normal(0, 1, (60, 2)), rng.uniform(0, 240, (60, 2))]) for p in pixels)
    pairs = np.stack([np.arange(120)] * 2, axis=1).astype(np.uint32)

    def found(options: pycolmap.TwoViewGeometryOptions) -> list[bytes]:
        options.ransac.max_num_trials, options.ransac.min_num_trials = 100, 10
        results = [pycolmap.estimate_two_view_geometry(camera, a, camera, b, pairs, options) for _ in range(4)]
        return [result.inlier_matches.tobytes() for result in results]

    assert len(set(found(verification_options(ColmapOptions())))) == 1
    assert len(set(found(pycolmap.TwoViewGeometryOptions()))) > 1, "COLMAP's default continues one random sequence"


def test_unsolvable_captures_are_one_sentence(arc: tuple[Capture, list[Camera]], tmp_path: Path) -> None:
    capture, _ = arc
    with pytest.raises(CaptureError, match="has 2 photographs"):
        Colmap(ColmapOptions()).initialize(replace(capture, views=capture.views[:2]), None, tmp_path)
    black = [
        replace(v, read=StoredPixels(replace(v.read(), color_linear=np.zeros((240, 320, 3), np.float32))))
        for v in capture.views
    ]
    with pytest.raises(CaptureError, match="only one colour"):
        Colmap(ColmapOptions()).initialize(replace(capture, views=tuple(black)), None, tmp_path)
    strangers = [
        View(f"{i}", None, StoredPixels(replace(v.read(), color_linear=room(cameras_on_an_arc(3)[1], i))))
        for i, v in enumerate(capture.views[:3])
    ]
    with pytest.raises(CaptureError, match="could not register"), pytest.warns(UserWarning, match="trying more"):
        Colmap(ColmapOptions(threads=1, max_features=500)).initialize(
            replace(capture, views=tuple(strangers)), None, tmp_path
        )


@pytest.fixture(scope="module")
def posed(arc: tuple[Capture, list[Camera]]) -> Capture:
    views = [replace(v, camera=c) for v, c in zip(arc[0].views, arc[1], strict=True)]
    return replace(arc[0], views=tuple(views))


def test_known_cameras_are_kept_and_their_points_lie_on_the_walls(posed: Capture, tmp_path: Path) -> None:
    colmap = Colmap(ColmapOptions(threads=1))
    found, _ = colmap.initialize(posed, None, tmp_path)
    assert colmap.report()["cameras"] == "of the capture"
    for before, after in zip(posed.cameras, found.cameras, strict=True):
        np.testing.assert_array_equal(before.world_to_camera, after.world_to_camera)
    assert found.points is not None and len(found.points.positions) > 100
    far = np.abs(found.points.positions).max(axis=1)
    assert np.median(np.minimum(np.abs(far - 0.6), np.abs(far - 3))) < 0.01


def test_cameras_solved_anew_keep_the_way_to_the_files_world(posed: Capture, tmp_path: Path) -> None:
    crooked = [
        replace(v, camera=replace(v.camera, intrinsics=v.camera.intrinsics * [[1.1], [1.1], [1.0]]))
        for v in posed.views
        if v.camera is not None
    ]
    options = ColmapOptions(threads=1, focal_length=310.0, known_cameras="solve")
    found, _ = Colmap(options).initialize(replace(posed, views=tuple(crooked)), None, tmp_path)
    assert all(abs(c.intrinsics[0, 0] - 300) < 6 for c in found.cameras)
    # in the files' world their own cameras show the points where the estimated ones do
    assert found.points is not None
    back = np.linalg.inv(found.world_from_source)
    there = found.points.positions @ back[:3, :3].T + back[:3, 3]
    given = [view.camera for view in crooked if view.camera is not None]
    pixels = [
        np.linalg.norm(old.project(there)[0] - new.project(found.points.positions)[0], axis=1)
        for old, new in zip(given, found.cameras, strict=True)
    ]
    # what is left, 1.6 of 320 pixels, is the perspective of a focal length that is 10 % wrong
    assert np.median(np.concatenate(pixels)) < 0.01 * given[0].width


@pytest.mark.parametrize("mapper,matching", [("global", "exhaustive"), ("incremental", "vocabulary")])
def test_other_ways_of_matching_and_mapping(
    arc: tuple[Capture, list[Camera]], tmp_path: Path, mapper: str, matching: str
) -> None:
    options = ColmapOptions(threads=1, focal_length=300.0, mapper=mapper, matching=matching)  # type: ignore[arg-type]
    solved, _ = Colmap(options).initialize(arc[0], None, tmp_path)
    rotations, positions = aligned([c.world_to_camera for c in solved.cameras], [c.world_to_camera for c in arc[1]])
    assert rotations.max() < 0.5 and positions.max() < 0.03


CUBE = hits_boxes(np.array([[[-0.6, -0.6, -0.6], [0.6, 0.6, 0.6]]]))


@pytest.fixture(scope="module")
def two_takes() -> tuple[Capture, list[Camera]]:
    """The cube before the walls of one room, and turned over before those of another, in the axes of the cube."""
    upright = cameras_on_an_arc(6)
    turned = [replace(c, world_to_camera=np.diag([-1.0, -1, 1, 1]) @ c.world_to_camera) for c in upright]
    views = []
    for take, cameras in enumerate((upright, turned)):
        for i, camera in enumerate(cameras):
            mask = (coverage(camera, CUBE, samples=1) > 0.5).astype(np.float32)
            color = np.where(mask[..., None] > 0, room(camera, 0), room(camera, 1 + take)).astype(np.float32)
            views.append(replace(make_view(f"{take}{i}", camera, mask, color), camera=None, take="ab"[take]))
    return Capture(Path("made-in-memory"), tuple(views)), upright + turned


@pytest.mark.slow
def test_takes_are_joined_by_the_object(
    two_takes: tuple[Capture, list[Camera]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    capture, true = two_takes
    located: list[str] = []
    gps = "hir_plugins.initializers.sfm.colmap.scale_of_gps"
    monkeypatch.setattr(gps, lambda views, seed: located.extend(view.take for view in views))
    options = ColmapOptions(threads=1, focal_length=300.0, refine_intrinsics=False)
    solved, _ = Colmap(options).initialize(capture, None, tmp_path)
    rotations, positions = aligned([c.world_to_camera for c in solved.cameras], [c.world_to_camera for c in true])
    assert rotations.max() < 1 and positions.max() < 0.05
    assert solved.takes == ("a", "b") and solved.take_numbers == capture.take_numbers
    ups = np.array([c.world_to_camera[:3, :3].T @ [0, -1, 0] for c in solved.cameras])
    assert ups[:6, 1].min() > 0.9 and ups[6:, 1].max() < -0.9, "upright as in the first take"
    assert located == ["a"] * 6, "positions of two takes are those of two worlds"


def test_a_take_that_is_not_joined_is_named(two_takes: tuple[Capture, list[Camera]], tmp_path: Path) -> None:
    """The second take shows another cube."""
    capture, cameras = two_takes
    views = list(capture.views)
    for i in range(6, 12):
        other = replace(views[i].read(), color_linear=room(cameras[i], 9))
        views[i] = replace(views[i], read=StoredPixels(other))
    options = ColmapOptions(threads=1, focal_length=300.0, refine_intrinsics=False, retry=False)
    with (
        pytest.warns(UserWarning, match="no photograph of the take b could be registered, so its 6 photographs"),
        pytest.warns(UserWarning, match="6 of 12 photographs could not be registered"),
    ):
        solved, _ = Colmap(options).initialize(replace(capture, views=tuple(views)), None, tmp_path)
    assert [view.camera is not None for view in solved.views] == [True] * 6 + [False] * 6


def test_what_cannot_join_takes_is_refused(two_takes: tuple[Capture, list[Camera]], tmp_path: Path) -> None:
    capture, _ = two_takes
    bare = replace(capture.views[3], read=StoredPixels(replace(capture.views[3].read(), mask=None)))
    one_bare = replace(capture, views=(*capture.views[:3], bare, *capture.views[4:]))
    with pytest.raises(CaptureError, match=r"the takes a, b are joined .* needs masks of all photographs"):
        Colmap(ColmapOptions()).initialize(one_bare, None, tmp_path)
    with pytest.raises(ConfigError, match="use_masks is false"):
        Colmap(ColmapOptions(use_masks=False)).initialize(capture, None, tmp_path)
    with pytest.raises(ConfigError, match="matching is 'sequential'"):
        Colmap(ColmapOptions(matching="sequential")).initialize(capture, None, tmp_path)


def test_the_background_never_joins_takes() -> None:
    assert [a.masked for a in attempts(ColmapOptions(), masked=True)] == [True, True, False]
    assert [a.masked for a in attempts(ColmapOptions(), masked=True, takes=2)] == [True, True]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*could not be registered")  # at most six of 66 may be left out; see below
def test_the_skull(shared: Path, tmp_path: Path) -> None:
    folder = shared / "photos" / "skull"
    capture = PhotosReader(NoOptions()).read(folder)
    solved, _ = Colmap(ColmapOptions()).initialize(capture, None, tmp_path)
    known = {
        Path(v["image"]).stem: np.array(v["world_to_cam"])
        for v in json.loads((folder / "cameras_opencv.json").read_text())["views"]
    }
    registered = [v for v in solved.views if v.camera is not None]
    assert len(registered) >= 60
    rotations, positions = aligned(
        [v.camera.world_to_camera for v in registered if v.camera], [known[v.name] for v in registered]
    )
    assert np.median(rotations) < 0.5 and np.median(positions) < 0.02
