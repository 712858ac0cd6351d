"""Stereo on painted shapes whose depth is known, and what fusion does to a hull."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import torch
from numpy.typing import NDArray
from PIL import Image

from hir_core.capture import Array, Camera, Capture, View
from hir_core.errors import CaptureError, ConfigError, MissingExtraError
from hir_core.mesh.mesh_validity import inspect_mesh
from hir_core.scene import Mesh, Scene, Topology
from hir_plugins.initializers.hull.visual_hull import VisualHull, hull_volume
from hir_plugins.initializers.options import PoissonOptions, StereoOptions, VisualHullOptions
from hir_plugins.initializers.poisson.poisson import Poisson, poisson_surface
from hir_plugins.initializers.stereo.depth_consistency import DepthMap, oriented_points
from hir_plugins.initializers.stereo.depth_fusion import carve_depths, smoothed_carving
from hir_plugins.initializers.stereo.patch_match import patch_match, write_workspace
from hir_plugins.initializers.stereo.stereo import Stereo, measure_depths
from hir_plugins.initializers.stereo.stereo_photographs import (
    choose_neighbours,
    crop_to_object,
    evenly_distributed_views,
)
from hir_plugins.initializers.stereo.surface_sweep import (
    SweepSettings,
    SweptView,
    box_sum,
    correlations,
    inverse_depth_step,
    semi_global,
    sweep,
    texture_confidence,
)
from hir_plugins.initializers.surface.isosurface import extract_surface, keep_large_components
from hir_plugins.initializers.surface.swept_surface import SweptSurface, signed_distance_volume
from hir_plugins.initializers.surface.volume import Volume
from tests.fixtures.silhouette_captures import StoredPixels, dome, hits_boxes, look_at, make_view
from tests.hir_plugins.initializers.test_colmap import room

CUBE = hits_boxes(np.array([[[-0.6] * 3, [0.6] * 3]]))


def rays_of(camera: Camera) -> tuple[Array, Array]:
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
    return camera.rays(np.stack([columns, rows], axis=-1).reshape(-1, 2))


def cube_depth(camera: Camera) -> np.ndarray:
    """True depth (H, W) of the cube, 0 beside it."""
    origins, directions = rays_of(camera)
    inverse = 1 / directions
    near = np.minimum((-0.6 - origins) * inverse, (0.6 - origins) * inverse).max(axis=1)
    hit = CUBE(origins, directions)
    along = directions @ camera.world_to_camera[2, :3]
    return np.where(hit, near * along, 0).reshape(camera.height, camera.width)


@pytest.fixture(scope="module")
def painted_cube() -> Capture:
    positions = [2.5 * np.array([np.sin(t), h, np.cos(t)]) for t in (0.5, 0.65, 0.8, 0.95) for h in (0.45, 0.6)]
    views = []
    for i, position in enumerate(positions):
        camera = look_at(position, np.zeros(3), 260.0, 192, 160)
        views.append(make_view(f"{i}", camera, (cube_depth(camera) > 0).astype(np.float32), room(camera, 0)))
    return Capture(Path("made-in-memory"), tuple(views))


def test_depth_without_a_hull_is_right_to_a_fraction_of_a_pixel(painted_cube: Capture) -> None:
    options = StereoOptions(max_image_size=192, neighbours=4, window=5, device="cpu")
    measured = measure_depths(painted_cube, None, options)
    assert measured.mesh is None and measured.carving is None
    errors, shares = [], []
    for found in measured.maps:
        # the map is of a part of the picture: its own camera says which
        truth = cube_depth(found.camera)
        inverse = found.inverse.numpy()
        kept = (inverse > 0) & (truth > 0)
        errors.append(1 / inverse[kept] - truth[kept])
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


def swept(view: object, inverse: NDArray[np.float32]) -> SweptView:
    pixels, camera = view.pixels(), view.camera  # type: ignore[attr-defined]
    inside = torch.from_numpy(pixels.mask > 0.5)
    image = torch.from_numpy(pixels.color_linear.mean(axis=2) * pixels.mask)
    values = torch.from_numpy(np.asarray(inverse, np.float32))
    return SweptView(camera, image, inside, inside, values, values)


def test_a_surface_too_far_in_front_is_found_again(painted_cube: Capture) -> None:
    def pushed(camera: Camera) -> NDArray[np.float32]:
        truth = cube_depth(camera)
        # four steps nearer than the cube
        return np.where(truth > 0, 1 / np.maximum(truth, 1e-3) + 4.3 * step, 0).astype(np.float32)

    cameras = painted_cube.cameras
    step = inverse_depth_step(cameras[0], cameras[1:4], np.zeros(3))
    views = [swept(view, pushed(view.camera)) for view in painted_cube.views[:4]]  # type: ignore[arg-type]
    found, score = sweep(views[0], views[1:], step, SweepSettings(window=7, inward=8, outward=2))
    truth = cube_depth(cameras[0])
    inner = torch.from_numpy(truth > 0)
    error = (found - torch.from_numpy(1 / np.maximum(truth, 1e-3)).float())[inner].abs() / step
    assert float(error.median()) < 0.15 and float(score[inner].median()) > 0.9
    assert float((found[~inner]).abs().max()) == 0


def test_nothing_is_moved_where_nothing_can_be_compared(painted_cube: Capture) -> None:
    views = []
    for view in painted_cube.views[:4]:
        truth = cube_depth(view.camera)  # type: ignore[arg-type]
        blank = swept(view, np.where(truth > 0, 1 / np.maximum(truth, 1e-3), 0))
        views.append(replace(blank, image=torch.full_like(blank.image, 0.5)))
    found, _ = sweep(views[0], views[1:], 0.01, SweepSettings(window=7, inward=8, outward=2))
    moved = (found - views[0].inverse)[views[0].inside].abs()
    # all but those whose match leaves the neighbour's picture
    assert float((moved < 1e-6).float().mean()) > 0.999 and float(moved.max()) < 0.01


def test_correlation_is_that_of_the_definition(painted_cube: Capture) -> None:
    truth = cube_depth(painted_cube.cameras[0])
    view = swept(painted_cube.views[0], np.where(truth > 0, 1 / np.maximum(truth, 1e-3), 0))
    # the picture compared with a brighter, harder copy of itself, in place
    copy = replace(view, image=2.0 * view.image + 0.1)
    found = correlations(view, [copy], view.inverse[None], 7)[0]
    # elsewhere windows are so flat that correlation fades
    assert float(found[texture_confidence(view.image, 7) > 0.95].min()) > 0.98
    rng = np.random.default_rng(0)
    noise = torch.from_numpy(rng.uniform(size=view.image.shape).astype(np.float32))
    found = correlations(replace(view, image=noise), [copy], view.inverse[None], 7)[0]
    window = (slice(70, 77), slice(90, 97))
    expected = np.corrcoef(noise[window].reshape(-1).numpy(), copy.image[window].reshape(-1).numpy())[0, 1]
    assert abs(float(found[73, 93]) - expected) < 2e-3
    ones = box_sum(torch.ones(1, 9, 9), 5)[0]
    assert ones[4, 4] == 25 and ones[0, 0] == 9


def test_semi_global_matching_bridges_what_is_flat() -> None:
    # twenty pixels, the middle without content; both ends say label 3
    cost = torch.ones(1, 20, 6)
    cost[0, :5, 3] = cost[0, -5:, 3] = 0
    cost[0, 5:15, 0] = 0.98
    base, known = torch.ones(1, 20), torch.ones(1, 20, dtype=torch.bool)
    total = semi_global(cost, base, known, 0.1, SweepSettings(7, 5, 0))
    assert (total.argmin(dim=2) == 3).all()
    # a jump of the surface in the middle cuts the path
    base[0, 8:12] = 5.0
    assert (semi_global(cost, base, known, 0.1, SweepSettings(7, 5, 0)).argmin(dim=2)[0, 8:12] == 0).all()


def test_neighbours_are_near_but_not_too_near() -> None:
    cameras = [
        look_at(3 * np.array([np.sin(t), 0, np.cos(t)]), np.zeros(3), 100.0, 64, 64)
        for t in np.radians([0, 0.5, 10, 25, 180])
    ]
    chosen = choose_neighbours(cameras, np.zeros(3), 4)
    assert chosen[0] == [2, 3] and chosen[4] == []


def test_neighbours_are_of_the_same_take(painted_cube: Capture) -> None:
    cameras, takes = painted_cube.cameras, [0, 1, 0, 1, 0, 1, 0, 2]
    chosen = choose_neighbours(cameras, np.zeros(3), 4, takes)
    assert all(takes[j] == takes[i] for i in range(8) for j in chosen[i])
    assert [len(own) for own in chosen] == [3, 2, 3, 2, 3, 2, 3, 0]
    assert choose_neighbours(cameras, np.zeros(3), 4, [0] * 8) == choose_neighbours(cameras, np.zeros(3), 4)


def test_each_take_has_its_share_of_the_photographs() -> None:
    cameras = dome(60, 3.0, np.zeros(3), 200.0, 64)
    takes = [0 if i % 3 else 1 for i in range(60)]
    chosen = evenly_distributed_views(cameras, np.zeros(3), 31, takes)
    assert chosen == sorted(set(chosen)) and [sum(takes[i] == take for i in chosen) for take in (0, 1)] == [21, 10]
    second = [i for i in range(60) if takes[i] == 1]
    alone = evenly_distributed_views([cameras[i] for i in second], np.zeros(3), 10)
    assert [i for i in chosen if takes[i] == 1] == [second[i] for i in alone]
    few = evenly_distributed_views(cameras, np.zeros(3), 3, [*range(20), *[20] * 40])
    assert len(few) == 3 and min(few) < 20


def test_photographs_of_another_light_do_not_change_the_depths(painted_cube: Capture) -> None:
    """A second take from the same places, with inverted brightness."""
    options = StereoOptions(
        max_image_size=96, neighbours=4, window=5, levels=1, max_resolution=48, verify_carving=False, device="cpu"
    )
    volume = hull_volume(painted_cube, VisualHullOptions(max_resolution=48))
    first = [replace(view, take="upright") for view in painted_cube.views]

    def under_other_light(view: View) -> View:
        pixels = view.read()
        inverted = (0.5 * (1 - pixels.color_linear) * [1.0, 0.7, 0.4]).astype(np.float32)
        return replace(view, take="turned over", read=StoredPixels(replace(pixels, color_linear=inverted)))

    alone = measure_depths(replace(painted_cube, views=tuple(first)), volume, options)
    mixed = [view for pair in zip(first, map(under_other_light, first), strict=True) for view in pair]
    together = measure_depths(replace(painted_cube, views=tuple(mixed)), volume, options)
    for found, expected in zip(together.maps[::2], alone.maps, strict=True):
        assert torch.equal(found.inverse, expected.inverse) and torch.equal(found.weight, expected.weight)
    measured = [float((each.inverse > 0).float().mean()) for each in together.maps]
    assert np.mean(measured[1::2]) > 0.8 * np.mean(measured[::2]) > 0.1
    assert together.points is not None and np.isfinite(together.points.positions).all()


def test_takes_of_one_photograph_each_have_no_depth(painted_cube: Capture) -> None:
    options = StereoOptions(max_image_size=64, neighbours=4, window=5, levels=1, max_resolution=32, device="cpu")
    capture = replace(painted_cube, views=tuple(replace(view, take=view.name) for view in painted_cube.views))
    volume = hull_volume(capture, VisualHullOptions(max_resolution=32))
    measured = measure_depths(capture, volume, options)
    assert measured.points is None and measured.carving is not None and measured.carving.is_empty
    assert not any(bool((each.inverse > 0).any()) for each in measured.maps)


def test_colmap_is_not_asked_for_a_photograph_without_neighbours(painted_cube: Capture, tmp_path: Path) -> None:
    cropped = (crop_to_object(view, 2, 1, np.zeros(3), 1.1) for view in painted_cube.views[:4])
    photographs = [photograph for photograph in cropped if photograph is not None]
    workspace = write_workspace(photographs, [[1, 2], [0], [], [2]], tmp_path)
    lines = (workspace / "stereo" / "patch-match.cfg").read_text().splitlines()
    assert lines == ["00000.png", "00001.png, 00002.png", "00001.png", "00000.png", "00003.png", "00002.png"]
    maps = patch_match(photographs, [[]] * 4, np.zeros(3), 1.1, tmp_path)
    assert [each.inverse.shape for each in maps] == [each.inside.shape for each in photographs]
    assert not any(bool(each.inverse.any() or each.weight.any()) for each in maps)


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
        depth = np.where(r2 < 0.04, 3 - np.sqrt(np.maximum(0.25 - r2, 0)) + 0.2, np.inf)
        inverse = torch.from_numpy((1 / depth).astype(np.float32))
        maps.append(DepthMap(camera, inverse, (inverse > 0).float()))
    return Volume(values, np.full(3, -0.8), 0.04), maps


def test_fusion_carves_a_dent_and_never_adds() -> None:
    volume, maps = hollow_volume()
    fused = carve_depths(volume, maps, min_weight=3)
    assert (fused.values <= volume.values).all()
    middle = fused.values[20, 20]
    z = np.linspace(-0.8, 0.8, 41)
    # the surface on the axis moved from 0.5 to 0.3
    crossing = z[np.nonzero(middle > 0)[0].max()]
    assert abs(crossing - 0.3) < 0.04
    # nothing was measured at the back
    np.testing.assert_array_equal(fused.values[:, :, :15], volume.values[:, :, :15])


def test_noise_of_a_carving_makes_no_handles() -> None:
    """Noise of a voxel in the dent makes handles; smoothed, the surface has none, the dent its depth, and what was not
    carved its values.
    """
    volume, maps = hollow_volume()
    fused = carve_depths(volume, maps, min_weight=3)
    carved = fused.values < volume.values - 0.02
    noise = np.random.default_rng(0).normal(scale=0.04, size=volume.values.shape).astype(np.float32)
    noisy = replace(fused, values=np.where(carved, np.minimum(fused.values + noise, volume.values), fused.values))
    smoothed = smoothed_carving(volume, noisy)
    genus = [inspect_mesh(*keep_large_components(*extract_surface(v), 0.02)).genus for v in (noisy, smoothed)]
    assert genus[0] > 0 and genus[1] == 0
    assert (smoothed.values <= volume.values).all()
    np.testing.assert_array_equal(smoothed.values[:, :, :15], volume.values[:, :, :15])
    z = np.linspace(-0.8, 0.8, 41)
    assert abs(z[np.nonzero(smoothed.values[20, 20] > 0)[0].max()] - 0.3) < 0.05


def test_a_mesh_becomes_a_volume_and_a_mesh_again() -> None:
    volume, _ = hollow_volume()
    positions, faces = extract_surface(volume)
    for scale, place in ((1.0, 0.0), (1e-3, 5.0)):
        moved = positions * scale + place
        again = signed_distance_volume(SweptSurface(moved, faces), moved, 0.03 * scale)
        back, _ = extract_surface(again)
        radii = np.linalg.norm(back - place, axis=1) / scale
        assert abs(radii - 0.5).max() < 0.006
        assert again.values.max() == pytest.approx(0.12 * scale) and again.values.min() == pytest.approx(-0.12 * scale)


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
    normals = rng.normal(size=(1500, 3))
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
    with pytest.raises(ConfigError, match="odd"):
        Stereo(StereoOptions(window=4))
    blind = replace(painted_cube, views=tuple(replace(v, camera=None) for v in painted_cube.views))
    with pytest.raises(CaptureError, match="no camera"):
        Stereo(StereoOptions()).initialize(blind, None, Path("unused"))


BOWL = 0.45
"""Depth of the dent in the bowl's top, which no outline shows."""


def bowl_depth(camera: Camera, dent: bool = True) -> NDArray[np.float64]:
    """Depth (H, W) of a ball of radius 0.8 whose top half is cut off, with a round dent in the cut."""
    origins, directions = rays_of(camera)
    along = directions @ camera.world_to_camera[2, :3]
    t = np.full(len(origins), np.inf)

    def offer(distance: Array, where: Callable[[Array], NDArray[np.bool_]]) -> None:
        with np.errstate(invalid="ignore"):
            points = origins + directions * np.where(np.isfinite(distance), distance, 0)[:, None]
            good = np.isfinite(distance) & (distance > 0) & where(points)
        t[good] = np.minimum(t[good], distance[good])

    def ball(center: Array, radius: float, far: bool) -> Array:
        offset = origins - center
        b = (offset * directions).sum(axis=1)
        root = b**2 - (offset**2).sum(axis=1) + radius**2
        with np.errstate(invalid="ignore"):
            return np.where(root > 0, -b + (1 if far else -1) * np.sqrt(np.maximum(root, 0)), np.inf)

    with np.errstate(divide="ignore"):
        plane = -origins[:, 1] / directions[:, 1]
    # the dent: a ball whose top lies above the cut, so that it meets the cut in a circle of radius 0.6
    radius = (0.6**2 + BOWL**2) / (2 * BOWL)
    middle = np.array([0, radius - BOWL, 0])
    offer(ball(np.zeros(3), 0.8, False), lambda p: p[:, 1] <= 0)
    if dent:
        offer(plane, lambda p: (np.hypot(p[:, 0], p[:, 2]) <= 0.8) & (np.hypot(p[:, 0], p[:, 2]) > 0.6))
        offer(ball(middle, radius, True), lambda p: p[:, 1] <= 0)
    else:
        offer(plane, lambda p: np.hypot(p[:, 0], p[:, 2]) <= 0.8)
    return np.where(np.isfinite(t), t * along, 0).reshape(camera.height, camera.width)


def bowl_capture(dent: bool, painted: bool = True) -> Capture:
    views = []
    rng = np.random.default_rng(0)
    waves = rng.normal(scale=7, size=(24, 3))
    phases = rng.uniform(0, 2 * np.pi, 24)
    for i, camera in enumerate(dome(36, 3.0, np.zeros(3), 190.0, 112)):
        depth = bowl_depth(camera, dent)
        origins, directions = rays_of(camera)
        along = directions @ camera.world_to_camera[2, :3]
        points = origins + directions * (depth.reshape(-1) / along)[:, None]
        value = 0.3 + 0.04 * np.cos(points @ waves.T + phases).sum(axis=1) if painted else np.full(len(points), 0.3)
        color = np.repeat(np.clip(value, 0.02, 0.9).reshape(112, 112, 1), 3, axis=2).astype(np.float32)
        views.append(make_view(f"{i}", camera, (depth > 0).astype(np.float32), color))
    return Capture(Path("made-in-memory"), tuple(views))


def dent_of(scene: Scene | None) -> float:
    """How far below the cut the surface lies in the middle of the bowl."""
    assert scene is not None
    positions = scene.mesh.positions.numpy()
    top = positions[(np.hypot(positions[:, 0], positions[:, 2]) < 0.12) & (positions[:, 1] > -0.7)]
    return float(-np.median(top[:, 1]))


QUICK = StereoOptions(max_image_size=112, vertex_colors=False, max_resolution=72)


@pytest.mark.slow
def test_stereo_carves_the_dent_that_no_outline_shows() -> None:
    capture = bowl_capture(dent=True)
    hull = VisualHull(VisualHullOptions(max_resolution=72, vertex_colors=False))
    _, whole = hull.initialize(capture, None, Path("unused"))
    assert dent_of(whole) < 0.02
    stereo = Stereo(QUICK)
    solved, scene = stereo.initialize(capture, whole, Path("unused"))
    # a pixel is 3 / 190 = 0.016, a voxel twice that
    assert abs(dent_of(scene) - BOWL) < 0.02
    assert solved.points is not None and scene is not None
    found = stereo.report()
    assert found["confirmed_share"] > 0.8 and found["correlation_gain"] > 0.1
    faces = np.sort(np.concatenate([scene.mesh.faces.numpy()[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
    assert (np.unique(faces, axis=0, return_counts=True)[1] == 2).all()


@pytest.mark.slow
@pytest.mark.parametrize("painted", [True, False])
def test_stereo_leaves_a_convex_thing_as_its_outlines_show_it(painted: bool) -> None:
    capture = bowl_capture(dent=False, painted=painted)
    hull = VisualHull(VisualHullOptions(max_resolution=72, vertex_colors=False))
    _, whole = hull.initialize(capture, None, Path("unused"))
    _, scene = Stereo(QUICK).initialize(capture, whole, Path("unused"))
    assert scene is not None and whole is not None
    shell = SweptSurface(whole.mesh.positions.double().numpy(), whole.mesh.faces.numpy())
    moved = np.abs(shell.signed_distance(scene.mesh.positions.double().numpy()))
    assert np.quantile(moved, 0.99) < 0.016


@pytest.mark.slow
def test_what_colmap_measures_is_carved_like_our_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Everything around COLMAP's PatchMatch; PatchMatch itself needs CUDA: its place is taken by the true depth."""
    capture = bowl_capture(dent=True)
    depth_range: dict[str, float] = {}

    def measured(workspace: str, options: pycolmap.PatchMatchOptions, cancellation_token: object) -> None:
        folder = Path(workspace)
        depth_range.update(low=options.depth_min, high=options.depth_max)
        model = pycolmap.Reconstruction(str(folder / "sparse"))
        choose_neighbours = (folder / "stereo" / "patch-match.cfg").read_text().splitlines()
        assert choose_neighbours[0::2] == [model.images[i].name for i in sorted(model.images)]
        for image in model.images.values():
            lens = model.cameras[image.camera_id]
            intrinsics, pose = np.eye(3), np.eye(4)
            intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]] = lens.params
            pose[:3] = image.cam_from_world().matrix()
            depth = bowl_depth(Camera(intrinsics, pose, lens.width, lens.height)).astype(np.float32)
            with Image.open(folder / "images" / image.name) as picture:
                assert picture.size == (lens.width, lens.height)
            stored = pycolmap.DepthMap.from_array(depth, options.depth_min, options.depth_max)
            stored.write(str(folder / "stereo" / "depth_maps" / f"{image.name}.geometric.bin"))

    monkeypatch.setattr("pycolmap.has_cuda", True)
    monkeypatch.setattr("pycolmap.patch_match_stereo", measured)
    stereo = Stereo(QUICK)
    solved, scene = stereo.initialize(capture, None, tmp_path)
    assert stereo.report()["method"] == "COLMAP PatchMatch on cuda"
    assert depth_range["low"] < 3 - 0.8 and depth_range["high"] > 3 + 0.8
    assert abs(dent_of(scene) - BOWL) < 0.02 and solved.points is not None


def test_patch_match_without_cuda_says_what_to_install() -> None:
    if pycolmap.has_cuda:
        pytest.skip("this COLMAP has CUDA")
    with pytest.raises(MissingExtraError, match="pycolmap-cuda12"):
        Stereo(StereoOptions(method="patch_match"))


@pytest.mark.slow
def test_a_given_surface_stays_where_photographs_agree_on_nothing() -> None:
    capture = bowl_capture(dent=False, painted=False)
    rng = np.random.default_rng(0)
    views = []
    for view in capture.views:
        pixels = view.read()
        noise = rng.uniform(size=(*pixels.color_linear.shape[:2], 1)).repeat(3, axis=2).astype(np.float32)
        views.append(make_view(view.name, view.camera, pixels.mask, noise))  # type: ignore[arg-type]
    _, whole = VisualHull(VisualHullOptions(max_resolution=48, vertex_colors=False)).initialize(
        capture, None, Path("unused")
    )
    assert whole is not None
    given = Scene(Mesh(whole.mesh.positions, Topology(whole.mesh.faces)))
    _, scene = Stereo(QUICK).initialize(replace(capture, views=tuple(views)), given, Path("unused"))
    assert scene is not None
    shell = SweptSurface(whole.mesh.positions.double().numpy(), whole.mesh.faces.numpy())
    moved = np.abs(shell.signed_distance(scene.mesh.positions.double().numpy()))
    assert np.quantile(moved, 0.95) < 0.04
