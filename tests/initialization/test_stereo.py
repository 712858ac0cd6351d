"""Stereo on a painted cube whose depth is known, and what fusion does to a hull."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hir_core.capture import Camera, Capture
from hir_core.errors import CaptureError
from hir_plugins.initializers.carving import Volume
from hir_plugins.initializers.depth_fusion import fuse_into, oriented_points
from hir_plugins.initializers.depth_maps import DepthMap, _best, _tensors, neighbours
from hir_plugins.initializers.options import PoissonOptions, StereoOptions
from hir_plugins.initializers.poisson import Poisson, poisson_surface
from hir_plugins.initializers.stereo import Stereo, _prepare, measure

from .silhouettes import dome, hits_boxes, look_at, make_view
from .test_colmap import room

CUBE = hits_boxes(np.array([[[-0.6] * 3, [0.6] * 3]]))


def cube_depth(camera: Camera) -> np.ndarray:
    """True depth (H, W) of the cube, 0 beside it."""
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
    origins, directions = camera.rays(np.stack([columns, rows], axis=-1).reshape(-1, 2))
    inverse = 1 / directions
    near = np.minimum((-0.6 - origins) * inverse, (0.6 - origins) * inverse).max(axis=1)
    hit = CUBE(origins, directions)
    along = directions @ camera.world_to_camera[2, :3]
    return np.where(hit, near * along, 0).reshape(camera.height, camera.width)


@pytest.fixture(scope="module")
def painted_cube() -> Capture:
    places = [2.5 * np.array([np.sin(t), h, np.cos(t)]) for t in (0.5, 0.65, 0.8, 0.95) for h in (0.45, 0.6)]
    views = []
    for i, place in enumerate(places):
        camera = look_at(place, np.zeros(3), 260.0, 192, 160)
        views.append(make_view(f"{i}", camera, (cube_depth(camera) > 0).astype(np.float32), room(camera, 0)))
    return Capture(Path("made-in-memory"), tuple(views))


def test_depth_is_right_to_a_fraction_of_a_pixel(painted_cube: Capture) -> None:
    options = StereoOptions(max_image_size=192, levels=2, neighbours=4, planes=48, window=5, min_views=2, device="cpu")
    measured = measure(painted_cube, np.zeros(3), 1.1, options)
    errors, shares = [], []
    for found in measured.maps:
        # the map is of a part of the picture: its own camera says which
        truth = cube_depth(found.camera)
        kept = (found.depth > 0) & (truth > 0)
        errors.append((found.depth - truth)[kept])
        shares.append(kept.sum() / (truth > 0).sum())
    every = np.abs(np.concatenate(errors))
    # at a baseline of 10°, 0.44 of 2.5, a pixel of parallax is 2.5² / (260 · 0.44) = 0.055 of depth
    assert np.median(every) < 0.055 / 4
    assert np.mean(shares) > 0.4
    points = measured.points
    assert points is not None and points.normals is not None
    distance = np.abs(np.abs(points.positions).max(axis=1) - 0.6)
    assert np.median(distance) < 0.012
    # normals stand on the faces, outward
    face = np.abs(points.positions).argmax(axis=1)
    flat = np.sort(np.abs(points.positions), axis=1)[:, 1] < 0.5
    outward = (points.normals * np.sign(points.positions))[np.arange(len(face)), face]
    assert np.median(outward[flat]) > 0.95


def test_a_step_between_two_hypotheses_is_interpolated(painted_cube: Capture) -> None:
    stereo = [_tensors(_prepare(v, 192, np.zeros(3), 1.1)[0], 1, "cpu") for v in painted_cube.views[:3]]
    truth = cube_depth(painted_cube.cameras[0])
    inverse = torch.from_numpy(np.where(truth > 0, 1 / np.maximum(truth, 1e-3), 0.4)).float()
    # the truth lies 0.3 of a step beside the middle of five
    step = 0.008
    found, _ = _best(stereo[0], stereo[1:], inverse - 0.3 * step, torch.arange(-2, 3) * step, window=7)
    inner = torch.from_numpy(truth > 0)
    assert float((found - inverse)[inner].abs().median()) < 0.15 * step


def test_neighbours_are_near_but_not_too_near() -> None:
    cameras = [look_at(3 * np.array([np.sin(t), 0, np.cos(t)]), np.zeros(3), 100.0, 64, 64)
               for t in np.radians([0, 0.5, 10, 25, 180])]  # fmt: skip
    chosen = neighbours(cameras, np.zeros(3), 4)
    assert chosen[0] == [2, 3] and chosen[4] == []


def hollow_volume() -> tuple[Volume, list[DepthMap]]:
    """A solid ball, and depth maps of it with a dent of 0.2 in its front."""
    axis = np.linspace(-0.8, 0.8, 41)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    values = (0.5 - np.sqrt(x * x + y * y + z * z)).astype(np.float32)
    maps = []
    for shift in (-0.2, -0.1, 0.0, 0.1, 0.2):
        camera = look_at(np.array([shift, 0, 3.0]), np.array([shift, 0, 0]), 200.0, 96, 96)
        rows, columns = np.mgrid[0:96, 0:96] + 0.5
        px, py = (columns - 48) / 200 * 3 + shift, (rows - 48) / 200 * 3
        r2 = px**2 + py**2
        depth = np.where(r2 < 0.04, 3 - np.sqrt(np.maximum(0.25 - r2, 0)) + 0.2, 0).astype(np.float32)
        maps.append(DepthMap(camera, depth, np.ones_like(depth)))
    return Volume(values, np.full(3, -0.8), 0.04), maps


def test_fusion_carves_a_dent_and_never_adds() -> None:
    volume, maps = hollow_volume()
    fused = fuse_into(volume, maps, reach=0.2, min_weight=3, doubt=0.02)
    assert (fused.values <= volume.values).all()
    middle = fused.values[20, 20]
    z = np.linspace(-0.8, 0.8, 41)
    # the surface on the axis moved from 0.5 to 0.3, and 0.02 of doubt back
    crossing = z[np.nonzero(middle > 0)[0].max()]
    assert abs(crossing - 0.32) < 0.04
    # nothing was measured at the back
    np.testing.assert_array_equal(fused.values[:, :, :15], volume.values[:, :, :15])


def test_points_of_a_map_face_its_camera() -> None:
    _, maps = hollow_volume()
    images = [np.full((96, 96, 3), 0.25, np.float32)] * len(maps)
    points = oriented_points(maps, images, 0.02)
    assert points is not None and points.normals is not None and points.colors is not None
    assert (points.normals[:, 2] > 0.5).all() and np.isfinite(points.positions).all()
    np.testing.assert_allclose(points.colors, 0.25, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(points.normals, axis=1), 1)


def test_poisson_closes_a_ball_of_any_size() -> None:
    from hir_core.capture import OrientedPoints

    rng = np.random.default_rng(0)
    normals = rng.normal(size=(6000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    for scale, place in ((1.0, 0.0), (1e-3, 5.0)):
        cloud = OrientedPoints(place + scale * normals, normals)
        positions, faces = poisson_surface(cloud, PoissonOptions(trim=0.0))
        radii = np.linalg.norm(positions - place, axis=1) / scale
        assert abs(np.median(radii) - 1) < 0.01 and radii.max() < 1.1
        assert faces.min() >= 0 and faces.max() < len(positions)


def test_what_is_missing_is_named(painted_cube: Capture) -> None:
    with pytest.raises(CaptureError, match="oriented points"):
        Poisson(PoissonOptions()).initialize(painted_cube, None, Path("unused"))
    with pytest.raises(CaptureError, match="odd"):
        Stereo(StereoOptions(window=4))
    blind = replace(painted_cube, views=tuple(replace(v, camera=None) for v in painted_cube.views))
    with pytest.raises(CaptureError, match="no camera"):
        Stereo(StereoOptions()).initialize(blind, None, Path("unused"))


@pytest.mark.slow
def test_a_surface_from_hull_and_stereo() -> None:
    # all round, so that the hull is closed
    views = []
    for i, camera in enumerate(dome(20, 3.0, np.zeros(3), 120.0, 80)):
        views.append(make_view(f"{i}", camera, (cube_depth(camera) > 0).astype(np.float32), room(camera, 0)))
    capture = Capture(Path("made-in-memory"), tuple(views))
    options = StereoOptions(max_image_size=80, levels=2, neighbours=3, planes=24, window=5, vertex_colors=False)
    solved, scene = Stereo(options).initialize(capture, None, Path("unused"))
    assert solved.points is not None and scene is not None
    positions = scene.mesh.positions.numpy()
    assert np.abs(positions).max() < 0.75
    faces = np.sort(np.concatenate([scene.mesh.faces.numpy()[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
    assert (np.unique(faces, axis=0, return_counts=True)[1] == 2).all()
