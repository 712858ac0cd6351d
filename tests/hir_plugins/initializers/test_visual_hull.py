"""The visual hull against shapes whose hull is known, and real captures whose mesh is known."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import open3d
import pytest
import trimesh
from scipy.spatial import cKDTree

from hir_core.capture import Capture
from hir_core.errors import CaptureError
from hir_core.plugins import NoOptions
from hir_core.scene import Scene
from hir_plugins.initializers.hull.visual_hull import VisualHull
from hir_plugins.initializers.options import VisualHullOptions
from hir_plugins.initializers.surface.silhouette_fields import signed_distance
from hir_plugins.initializers.surface.vertex_colors import vertex_colors
from hir_plugins.readers.transforms_json import TransformsJsonReader
from tests.fixtures.silhouette_captures import (
    coverage,
    dome,
    hits_boxes,
    hits_sphere,
    look_at,
    make_view,
    shape_capture,
)

BALL = hits_sphere(np.zeros(3), 0.5)


def hull(capture: Capture, **options: object) -> Scene:
    _, scene = VisualHull(VisualHullOptions(**options)).initialize(capture, None, Path("unused"))  # type: ignore[arg-type]
    assert scene is not None
    return scene


def solid(scene: Scene) -> trimesh.Trimesh:
    """The mesh, which must be a closed manifold that is counter-clockwise from outside."""
    mesh = trimesh.Trimesh(scene.mesh.positions.numpy(), scene.mesh.faces.numpy(), process=False)
    edges = np.sort(mesh.edges, axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
    assert mesh.is_winding_consistent and mesh.volume > 0
    return mesh


@pytest.mark.parametrize("offset", [0.0, 0.3, 0.5, 0.9])
def test_distances_are_exact_between_pixels(offset: float) -> None:
    columns = np.arange(40)
    mask = np.broadcast_to(np.clip(columns + 1 - (20 + offset), 0, 1), (30, 40)).astype(np.float32)
    distance = signed_distance(np.ascontiguousarray(mask))
    # inside is to the right of x = 20 + offset; pixel centres lie at .5
    np.testing.assert_allclose(distance[15], columns + 0.5 - (20 + offset), atol=0.51)
    near = np.abs(columns + 0.5 - 20 - offset) < 2
    np.testing.assert_allclose(distance[15, near], (columns + 0.5 - 20 - offset)[near], atol=0.13)


def test_distances_of_a_disk() -> None:
    camera = look_at(np.array([0, 0, 4.0]), np.zeros(3), 200.0, 64, 64)
    mask = coverage(camera, BALL, samples=8)
    radius = 200 * 0.5 / np.sqrt(16 - 0.25)
    rows, columns = np.mgrid[0:64, 0:64] + 0.5
    truth = radius - np.hypot(rows - 32, columns - 32)
    error = (signed_distance(mask) - truth)[np.abs(truth) < 2]
    assert np.abs(error).max() < 0.15 and abs(error.mean()) < 0.03


@pytest.mark.parametrize(
    ("scale", "place"),
    [
        pytest.param(1.0, (0, 0, 0), marks=pytest.mark.slow),
        (1e-4, (3e-3, 0, 1e-3)),
        (1e5, (4e6, -2e6, 1e6)),
    ],
)
def test_a_ball_of_any_size_at_any_place(scale: float, place: tuple[float, ...]) -> None:
    center = np.array(place, dtype=float)
    cameras = dome(40, 3 * scale, center, 150.0, 96)
    scene = hull(shape_capture(cameras, hits_sphere(center, 0.5 * scale)), vertex_colors=False)
    mesh = solid(scene)
    radii = np.linalg.norm(mesh.vertices - center, axis=1) / scale
    # a pixel is 3 / 150 = 0.02 wide there; a hull of 40 cones stands out of the ball between the tangent circles
    assert radii.min() > 0.5 - 0.004
    assert np.median(radii) < 0.5 + 0.01 and radii.max() < 0.56


def inside(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Which points lie inside of a closed mesh."""
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
    return np.asarray(scene.compute_occupancy(points.astype(np.float32)).numpy() > 0.5)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:the masks of 014 contradict")  # one of thirty; the legs stay whole
def test_thin_legs_stay_whole() -> None:
    leg = 0.02
    boxes = [[[-0.5, 0.2, -0.5], [0.5, 0.26, 0.5]]]
    boxes += [[[x - leg, -0.6, z - leg], [x + leg, 0.2, z + leg]] for x in (-0.45, 0.45) for z in (-0.45, 0.45)]
    cameras = dome(30, 4.0, np.zeros(3), 330.0, 160)
    mesh = solid(hull(shape_capture(cameras, hits_boxes(np.array(boxes))), vertex_colors=False))
    assert mesh.body_count == 1
    # each leg is there over its whole length: 0.04 wide are 3.3 pixels
    for x in (-0.45, 0.45):
        for z in (-0.45, 0.45):
            near = mesh.vertices[np.hypot(mesh.vertices[:, 0] - x, mesh.vertices[:, 2] - z) < 0.05]
            assert near[:, 1].min() < -0.57
            axis = np.array([[x, y, z] for y in np.linspace(-0.57, 0.2, 200)])
            assert inside(mesh, axis).all()


def test_a_mask_with_a_hole_that_only_it_sees_is_left_out_and_named() -> None:
    cameras = dome(24, 3.0, np.zeros(3), 120.0, 64)
    views = list(shape_capture(cameras, BALL).views)
    pierced = views[7].pixels().mask.copy()  # type: ignore[union-attr]
    pierced[28:36, 28:36] = 0
    views[7] = make_view("007", cameras[7], pierced)
    with pytest.warns(UserWarning, match="of 007 contradict"):
        mesh = solid(hull(replace(shape_capture(cameras, BALL), views=tuple(views)), vertex_colors=False))
    assert np.linalg.norm(mesh.vertices, axis=1).min() > 0.47


def test_a_gap_that_few_photographs_look_into_stays_open() -> None:
    # two blocks a tenth apart: only cameras near the plane between them see light
    boxes = np.array([[[-0.5, -0.4, -0.4], [-0.05, 0.4, 0.4]], [[0.05, -0.4, -0.4], [0.5, 0.4, 0.4]]])
    cameras = dome(24, 3.0, np.zeros(3), 200.0, 128)
    seeing = look_at(np.array([0, 0, 3.0]), np.zeros(3), 200.0, 128, 128)
    mesh = solid(hull(shape_capture([*cameras, seeing], hits_boxes(boxes)), vertex_colors=False))
    # what the one camera in the middle plane sees through is empty, a mask that stands alone as it may be
    assert not inside(mesh, np.array([[0, y, z] for y in (-0.2, 0, 0.2) for z in (-0.3, 0, 0.3)])).any()


def test_one_bad_mask_is_left_out_and_named() -> None:
    cameras = dome(24, 3.0, np.zeros(3), 120.0, 64)
    capture = shape_capture(cameras, BALL)
    views = list(capture.views)
    shifted = np.roll(views[7].pixels().mask, 30, axis=1)  # type: ignore[arg-type]
    views[7] = make_view("007", cameras[7], shifted)
    with pytest.warns(UserWarning, match="of 007 contradict"):
        mesh = solid(hull(replace(capture, views=tuple(views)), vertex_colors=False))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        good = solid(hull(capture, vertex_colors=False))
    assert abs(mesh.volume / good.volume - 1) < 0.02


def test_a_tolerated_view_does_not_carve() -> None:
    cameras = dome(24, 3.0, np.zeros(3), 120.0, 64)
    capture = shape_capture(cameras, BALL)
    views = list(capture.views)
    views[3] = make_view("003", cameras[3], np.roll(views[3].pixels().mask, 30, axis=1))  # type: ignore[arg-type]
    spoilt = replace(capture, views=tuple(views))
    strict = solid(hull(spoilt, drop_bad_views=False, vertex_colors=False)).volume
    tolerant = solid(hull(spoilt, drop_bad_views=False, tolerated_views=1, vertex_colors=False)).volume
    ball = 4 / 3 * np.pi * 0.5**3
    assert strict < 0.6 * ball
    # chords of voxels a tenth of the radius cut about 1 % off a ball
    assert 0.99 * ball < tolerant < 1.25 * ball


def test_an_empty_mask_does_not_carve() -> None:
    cameras = dome(12, 3.0, np.zeros(3), 120.0, 64)
    capture = shape_capture(cameras, BALL)
    black = make_view("black", cameras[0], np.zeros((64, 64), np.float32))
    with pytest.warns(UserWarning, match="no outline.*black"):
        solid(hull(replace(capture, views=(*capture.views, black)), vertex_colors=False))


@pytest.mark.slow
def test_an_object_that_some_pictures_cut_off() -> None:
    # the last six cameras come close and show a part of the ball only
    cameras = dome(24, 3.0, np.zeros(3), 120.0, 64) + dome(6, 1.2, np.array([0.2, 0.1, 0.0]), 120.0, 64)
    mesh = solid(hull(shape_capture(cameras, BALL), vertex_colors=False))
    assert abs(mesh.volume / (4 / 3 * np.pi * 0.5**3) - 1) < 0.12


def test_masks_without_a_common_point_are_an_error() -> None:
    cameras = dome(12, 3.0, np.zeros(3), 120.0, 64)
    capture = shape_capture(cameras, BALL)
    turned = tuple(
        replace(v, camera=look_at(2 * v.camera.center, 8 * v.camera.center, 120.0, 64, 64))  # type: ignore[union-attr]
        for v in capture.views
    )
    with pytest.raises(CaptureError, match="camera"):
        hull(replace(capture, views=turned))


def test_captures_without_masks_or_cameras_say_what_to_do() -> None:
    cameras = dome(4, 3.0, np.zeros(3), 120.0, 64)
    capture = shape_capture(cameras, BALL)
    for views in (capture.views[:1], (), tuple(replace(v, camera=None) for v in capture.views)):
        with pytest.raises(CaptureError, match="at least two photographs"):
            hull(replace(capture, views=views))


def test_vertices_take_the_colour_that_views_agree_on() -> None:
    # a ball, red to the right of the world's x = 0 and blue to its left; one view is white all over
    cameras = dome(30, 3.0, np.zeros(3), 120.0, 64)
    views = []
    for i, camera in enumerate(cameras):
        mask = coverage(camera, BALL)
        rows, columns = np.mgrid[0:64, 0:64] + 0.5
        origins, directions = camera.rays(np.stack([columns, rows], axis=-1).reshape(-1, 2))
        along = -(origins * directions).sum(axis=1)
        depth = along - np.sqrt(np.maximum(0.25 - (origins**2).sum(axis=1) + along**2, 0))
        x = (origins + depth[:, None] * directions)[:, 0].reshape(64, 64)
        color = np.where(x[..., None] > 0, [0.8, 0.05, 0.05], [0.05, 0.05, 0.6]).astype(np.float32)
        views.append(make_view(f"{i}", camera, mask, np.ones_like(color) if i == 11 else color))
    scene = hull(Capture(Path("made-in-memory"), tuple(views)))
    assert scene.mesh.vertex_colors is not None
    x, colors = scene.mesh.positions[:, 0].numpy(), scene.mesh.vertex_colors.numpy()
    assert np.abs(colors[x > 0.06] - [0.8, 0.05, 0.05]).max() < 1e-3
    assert np.abs(colors[x < -0.06] - [0.05, 0.05, 0.6]).max() < 1e-3


def test_vertices_take_the_mean_of_the_takes_colours() -> None:
    """Two takes of 20 and 10 photographs, under red light and under blue: their median would be the first one's."""
    cameras = dome(30, 3.0, np.zeros(3), 120.0, 64)
    lights = [np.array([0.8, 0.1, 0.1]), np.array([0.1, 0.1, 0.6])]
    views = []
    for i, camera in enumerate(cameras):
        take = int(i % 3 == 0)
        color = np.broadcast_to(lights[take], (64, 64, 3)).astype(np.float32)
        view = make_view(f"{i}", camera, coverage(camera, BALL), color)
        views.append(replace(view, take=["upright", "turned over"][take]))
    mesh = hull(Capture(Path("made-in-memory"), tuple(views))).mesh
    assert mesh.vertex_colors is not None
    colors = mesh.vertex_colors.numpy()
    share = (colors[:, 0] - 0.1) / 0.7  # of the red light
    np.testing.assert_allclose(colors, share[:, None] * lights[0] + (1 - share[:, None]) * lights[1], atol=1e-3)
    assert share.mean() == pytest.approx(2 / 3, abs=0.05) and ((share > 0.2) & (share < 1)).mean() > 0.95
    red = replace(views[1], take="")
    alone = vertex_colors(mesh.positions.double().numpy(), mesh.faces.numpy(), [red])
    named = vertex_colors(mesh.positions.double().numpy(), mesh.faces.numpy(), [views[1]])
    np.testing.assert_array_equal(alone, named)


@pytest.mark.slow
def test_occluded_vertices_do_not_take_the_colour_of_the_occluder() -> None:
    # a green ball behind a white wall for half of the views: occluded vertices must stay green
    boxes = np.array([[[-0.2, -0.2, -0.2], [0.2, 0.2, 0.2]], [[-0.2, -0.2, 0.6], [0.2, 0.2, 0.7]]])
    cameras = dome(40, 4.0, np.array([0, 0, 0.2]), 200.0, 96)
    views = []
    for i, camera in enumerate(cameras):
        rows, columns = np.mgrid[0:96, 0:96] + 0.5
        rays = camera.rays(np.stack([columns, rows], axis=-1).reshape(-1, 2))
        wall = hits_boxes(boxes[1:])(*rays).reshape(96, 96)
        box = hits_boxes(boxes[:1])(*rays).reshape(96, 96)
        wall_first = wall & (~box | (camera.center[2] > 0.4))
        color = np.where(wall_first[..., None], 1.0, [0.0, 0.5, 0.0]).astype(np.float32)
        views.append(make_view(f"{i}", camera, coverage(camera, hits_boxes(boxes)), color))
    scene = hull(Capture(Path("made-in-memory"), tuple(views)))
    assert scene.mesh.vertex_colors is not None
    facing = np.abs(scene.mesh.positions.numpy() - [0, 0, 0.2])
    behind = (facing[:, 0] < 0.12) & (facing[:, 1] < 0.12) & (facing[:, 2] < 0.03)
    assert behind.sum() > 20
    colors = scene.mesh.vertex_colors.numpy()[behind]
    np.testing.assert_allclose(np.median(colors, axis=0), [0, 0.5, 0], atol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "limit"), [("spot", 0.006), ("avocado", 0.02)])
def test_real_captures_lie_on_their_true_mesh(shared: Path, name: str, limit: float) -> None:
    capture = TransformsJsonReader(NoOptions()).read(shared / "captures" / name)
    truth = trimesh.load(shared / "captures" / name / "reference.obj", force="mesh", process=False)
    truth.apply_transform(capture.world_from_source)
    true = trimesh.sample.sample_surface(truth, 50000, seed=1)[0]
    for surface in ("membrane", "hull"):
        mesh = solid(hull(capture, unseen_surface=surface))
        ours = trimesh.sample.sample_surface(mesh, 50000, seed=0)[0]
        assert cKDTree(true).query(ours)[0].mean() < limit and cKDTree(ours).query(true)[0].mean() < limit
    # a hull never cuts into the object by more than its sampling: two pixels of 0.0046
    hull_scene = open3d.t.geometry.RaycastingScene()
    hull_scene.add_triangles(
        open3d.core.Tensor(mesh.vertices.astype(np.float32)), open3d.core.Tensor(mesh.faces.astype(np.uint32))
    )
    outside = hull_scene.compute_signed_distance(open3d.core.Tensor(true.astype(np.float32))).numpy()
    assert outside.max() < 0.0092
