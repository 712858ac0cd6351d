"""Openings that no outline shows are sunk where photographs show a hollow, and nowhere else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from hir_core.capture import Array, Capture, View
from hir_core.errors import ConfigError, StageError
from hir_core.mesh.exposure_differences import exposure_corrections
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.plugins.options import build_options
from hir_core.scene import Scene
from hir_plugins.initializers.hollows import outline_search, search
from hir_plugins.initializers.hollows.hollows import Hollows
from hir_plugins.initializers.hollows.openings import Opening, find_openings, surface_cells
from hir_plugins.initializers.hollows.photo_prediction import (
    BlurredPhotograph,
    PredictedPixels,
    blurred_photographs,
    color_variance,
)
from hir_plugins.initializers.hollows.reflection import reflection_errors
from hir_plugins.initializers.hollows.search import find_hollows
from hir_plugins.initializers.hollows.sunk_volume import WALL, Solid, reach, sunk, wall_distance
from hir_plugins.initializers.hull.visual_hull import VisualHull
from hir_plugins.initializers.options import HollowsOptions, VisualHullOptions
from hir_plugins.initializers.surface.swept_surface import SweptSurface, signed_distance_volume
from hir_plugins.initializers.surface.vertex_colors import vertex_normals
from hir_plugins.initializers.surface.volume import Volume
from tests.fixtures.silhouette_captures import dome, make_view
from tests.hir_plugins.initializers.test_stereo import rays_of

SIDE = 80
Paint = Callable[[Array, Array], Array]
"""Points and directions toward the camera, both (N, 3) → brightness (N,)."""


def cup() -> trimesh.Trimesh:
    """A cup of radius 0.6 and height 0.8 that opens upwards, with walls of 0.1."""
    outer = trimesh.creation.annulus(0.5, 0.6, 0.8, sections=64)
    floor = trimesh.creation.cylinder(0.55, 0.1, sections=64)
    floor.apply_translation([0, 0, -0.35])
    whole = outer + floor
    whole.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))
    return whole


def bowl() -> trimesh.Trimesh:
    """Half of an ellipsoid with radii of 0.6 and 0.7 that opens upwards, with a wall of 0.15."""
    angle = np.linspace(0, np.pi / 2, 24)
    outer = np.stack([0.6 * np.sin(angle), 0.35 - 0.7 * np.cos(angle)], axis=1)
    inner = np.stack([0.45 * np.sin(angle), 0.35 - 0.55 * np.cos(angle)], axis=1)[::-1]
    whole = trimesh.creation.revolve(np.concatenate([outer, inner]), sections=64)
    whole.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))
    return whole


def block() -> trimesh.Trimesh:
    return trimesh.creation.cylinder(
        0.6, 0.8, sections=64, transform=trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0])
    )


def waves(vectors: Array, count: int = 24, scale: float = 7.0) -> Array:
    rng = np.random.default_rng(3)
    waves, phases = rng.normal(scale=scale, size=(count, 3)), rng.uniform(0, 2 * np.pi, count)
    return np.clip(0.4 + 0.06 * np.cos(vectors @ waves.T + phases).sum(axis=1), 0.02, 0.95)


def painted(points: Array, toward: Array) -> Array:
    del toward
    return waves(points)


def photographed(mesh: trimesh.Trimesh, paint: Paint, count: int = 24, take: str = "") -> Capture:
    queries = MeshQueries(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    views = []
    for i, camera in enumerate(dome(count, 3.0, np.zeros(3), 1.6 * SIDE, SIDE)):
        origins, directions = rays_of(camera)
        distance = queries.first_distances(origins, directions).astype(np.float64)
        hit = np.isfinite(distance)
        points = origins + directions * np.where(hit, distance, 0)[:, None]
        value = np.where(hit, paint(points, -directions), 0).reshape(SIDE, SIDE, 1)
        color = np.repeat(value, 3, axis=2).astype(np.float32)
        views.append(make_view(f"{take}{i}", camera, hit.reshape(SIDE, SIDE).astype(np.float32), color))
    return Capture(Path("made-in-memory"), tuple(replace(view, take=take) for view in views))


def hull_of(capture: Capture) -> Scene:
    hull = VisualHull(VisualHullOptions(max_resolution=64, vertex_colors=False))
    _, scene = hull.initialize(capture, None, Path("unused"))
    assert scene is not None
    return scene


def hollowed(capture: Capture, scene: Scene, most: int = 1) -> tuple[Scene, list[dict[str, float]]]:
    initializer = Hollows(HollowsOptions(vertex_colors=False, max_hollows=most))
    same, found = initializer.initialize(capture, scene, Path("unused"))
    assert same is capture and found is not None
    described = initializer.report()["hollows"]
    assert isinstance(described, list)
    return found, described


def height_inside(scene: Scene) -> float:
    """Of the surface under the middle of the opening."""
    queries = MeshQueries(scene.mesh.positions.double().numpy(), scene.mesh.faces.numpy())
    down = np.array([[0.0, -1.0, 0.0]])
    return 2.0 - float(queries.first_distances(np.array([[0.0, 2.0, 0.0]]), down)[0])


SECTORS = outline_search.SECTORS


@pytest.mark.parametrize("sectors", [4, pytest.param(SECTORS, marks=pytest.mark.slow)])
def test_a_cup_is_hollow(sectors: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """With fewer sectors and flat floors alone there are fewer outlines to try, which takes most of the time."""
    monkeypatch.setattr(outline_search, "SECTORS", sectors)
    if sectors < SECTORS:
        monkeypatch.setattr(outline_search, "ROUNDINGS", ())
    capture = photographed(cup(), painted)
    hull = hull_of(capture)
    assert height_inside(hull) > 0.3
    scene, hollows = hollowed(capture, hull)
    assert hollows[0]["explained"] > 0.6 > 0.2 > hollows[0]["explained_before"]
    assert hollows[0]["explained_by_reflection"] < 0.2
    assert height_inside(scene) < -0.15, "the floor is at -0.3"
    queries = MeshQueries(np.asarray(cup().vertices), np.asarray(cup().faces))
    new = MeshQueries(scene.mesh.positions.double().numpy(), scene.mesh.faces.numpy())
    angle = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    ring = np.stack([np.cos(angle), np.zeros(32), np.sin(angle)], axis=1)
    assert (new.signed_distance(0.36 * ring) > 0).mean() > 0.8, "0.14 inside the wall, in nearly all directions"
    assert (new.signed_distance(0.56 * ring) < 0).mean() > 0.9, "the wall stays"
    assert queries.nearest(scene.mesh.positions.double().numpy())[0].mean() < 0.04


@pytest.mark.slow
def test_the_floor_of_a_bowl_rises_towards_its_rim(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outline_search, "SECTORS", 1)
    truth = bowl()
    assert truth.is_watertight and truth.volume > 0
    capture = photographed(truth, painted)
    scene, hollows = hollowed(capture, hull_of(capture))
    assert hollows[0]["explained"] > 0.8 and hollows[0]["rounding"] > 0
    assert height_inside(scene) == pytest.approx(-0.2, abs=0.08)
    angle = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    ring = np.stack([np.cos(angle), np.zeros(32), np.sin(angle)], axis=1)
    new = MeshQueries(scene.mesh.positions.double().numpy(), scene.mesh.faces.numpy())
    # a well of this depth with straight walls has no solid here
    solid = 0.4 * ring - [0, 0.05, 0]
    assert (MeshQueries(np.asarray(truth.vertices), np.asarray(truth.faces)).signed_distance(solid) < 0).all()
    assert (new.signed_distance(solid) < 0).mean() > 0.8
    assert (new.signed_distance(0.25 * ring) > 0).mean() > 0.8


def lit_metal(points: Array, toward: Array) -> Array:
    """A ball of metal under four lamps: what it shows depends on the mirror direction."""
    normal = points / np.linalg.norm(points, axis=1, keepdims=True)
    mirrored = 2 * (normal * toward).sum(axis=1, keepdims=True) * normal - toward
    lamps = np.array([[0.8, 0.6, 0.0], [-0.5, 0.7, 0.5], [0.0, 0.3, -0.95], [0.1, 1.0, 0.2]])
    lamps /= np.linalg.norm(lamps, axis=1, keepdims=True)
    return np.asarray(0.1 + 0.6 * np.exp(12 * (mirrored @ lamps.T - 1)).sum(axis=1))


def test_reflections_explain_a_metal_and_no_opening() -> None:
    """Shares of the variance, of the pixels that look at the upper half of a ball, and into a cup with a lid."""
    explained = {}
    for name, mesh, paint in (("metal", trimesh.creation.icosphere(4, 0.6), lit_metal), ("cup", cup(), painted)):
        capture = photographed(mesh, paint)
        hull = hull_of(capture)
        vertices = hull.mesh.positions.double().numpy()
        volume = signed_distance_volume(SweptSurface(vertices, hull.mesh.faces.numpy()), vertices, 1.2 / 64)
        seen = blurred_photographs(capture, volume.spacing)
        pixels = {i: np.argwhere(np.tril(photograph.valid))[::9, ::-1] for i, photograph in enumerate(seen)}
        found = reflection_errors(pixels, volume, MeshQueries(*outline_search.smooth_triangles(volume)), seen)
        shares = []
        for i, errors in found.items():
            own = seen[i].colors[pixels[i][:, 1], pixels[i][:, 0]]
            known = np.isfinite(errors)
            assert known.mean() > 0.8
            shares.append(1 - errors[known].mean() / ((own - own.mean(axis=0)) ** 2).sum(axis=1).mean())
        explained[name] = float(np.mean(shares))
    assert explained["metal"] > 0.6 > 0.2 > explained["cup"], explained


@pytest.mark.slow
def test_a_hole_that_no_outline_shows_is_open() -> None:
    capture_directions = np.stack([camera.center for camera in dome(24, 1.0, np.zeros(3), 1.0, 8)])
    along = np.array([[np.cos(2.1), 0.0, np.sin(2.1)]])
    assert np.abs(capture_directions @ along[0]).max() < np.cos(np.arctan(0.4 / 1.3)), "nobody looks through"
    tube = trimesh.creation.annulus(0.2, 0.5, 1.3, sections=64)
    tube.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], along[0]))
    capture = photographed(tube, painted)
    hull = hull_of(capture)
    start = -2.0 * along

    def is_open(scene: Scene) -> bool:
        queries = MeshQueries(scene.mesh.positions.double().numpy(), scene.mesh.faces.numpy())
        return not np.isfinite(queries.first_distances(start, along)).any()

    assert not is_open(hull)
    scene, hollows = hollowed(capture, hull, 4)
    assert is_open(scene) and len(hollows) >= 1
    new = MeshQueries(scene.mesh.positions.double().numpy(), scene.mesh.faces.numpy())
    angle = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    side = np.stack([-along[0, 2], 0, along[0, 0]])
    circle = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * [0, 1, 0]
    assert (new.signed_distance(0.38 * circle) < 0).mean() > 0.9, "the wall stays"


@pytest.mark.slow
@pytest.mark.parametrize("paint", ["painted", "mirror"])
def test_what_is_solid_stays_as_it_is(paint: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outline_search, "SECTORS", 4 if paint == "mirror" else SECTORS)

    def reflected(points: Array, toward: Array) -> Array:
        normals = points * [1, 0, 1]
        lid = np.abs(points[:, 1]) > 0.399
        normals[lid] = np.sign(points[lid]) * [0, 1, 0]
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        return waves(2 * (normals * toward).sum(axis=1, keepdims=True) * normals - toward, scale=4)

    capture = photographed(block(), painted if paint == "painted" else reflected)
    hull = hull_of(capture)
    scene, hollows = hollowed(capture, hull)
    assert scene is hull and hollows == []


def test_a_surface_is_needed_and_nothing_may_be_asked_for() -> None:
    capture = photographed(block(), painted, count=8)
    with pytest.raises(StageError, match="visual_hull"):
        Hollows(HollowsOptions()).initialize(capture, None, Path("unused"))
    hull = hull_of(capture)
    initializer = Hollows(HollowsOptions(max_hollows=0))
    assert initializer.initialize(capture, hull, Path("unused"))[1] is hull
    assert initializer.report() == {"hollows": []}


def test_the_true_surface_predicts_photographs_and_a_lid_does_not() -> None:
    capture = photographed(cup(), painted)
    photographs = blurred_photographs(capture, 0.02)
    true, lid = (MeshQueries(np.asarray(mesh.vertices), np.asarray(mesh.faces)) for mesh in (cup(), block()))
    above = max(range(24), key=lambda i: photographs[i].camera.center[1])
    pixels = {above: np.argwhere(photographs[above].valid)[::7, ::-1]}
    predicted = PredictedPixels.of(pixels, photographs)
    errors = {name: predicted.errors(queries, 0.02)[above] for name, queries in (("true", true), ("lid", lid))}
    assert np.nanmedian(errors["true"]) < 1e-3 < 8 * np.nanmedian(errors["true"]) < np.nanmedian(errors["lid"])
    # another light says nothing about this one's photographs
    alone = [replace(photograph, take=i) for i, photograph in enumerate(photographs)]
    assert np.isnan(PredictedPixels.of(pixels, alone).errors(true, 0.02)[above]).all()
    # nobody looks from more than half a turn away
    assert np.isnan(predicted.errors(true, 0.02, 180.0)[above]).all()


def test_predictions_of_all_pixels_together_are_those_of_each_alone() -> None:
    """Against a loop over pixels, photographs and triangles."""
    capture = photographed(cup(), painted)
    photographs = [replace(each, take=i % 3 == 0) for i, each in enumerate(blurred_photographs(capture, 0.02))]
    mesh, lift, least = cup(), 0.02, 30.0
    pixels = {i: np.argwhere(photographs[i].valid)[5::97, ::-1] for i in (1, 3, 10)}
    predicted = PredictedPixels.of(pixels, photographs)
    found = predicted.errors(MeshQueries(np.asarray(mesh.vertices), np.asarray(mesh.faces)), lift, least)
    assert list(found) == list(pixels)
    for i, chosen in pixels.items():
        expected = [_predicted_alone(mesh, photographs, i, pixel, lift, least) for pixel in chosen]
        np.testing.assert_allclose(found[i], expected, rtol=1e-3, atol=1e-6)
        assert np.isfinite(expected).any()


def _predicted_alone(
    mesh: trimesh.Trimesh,
    photographs: list[BlurredPhotograph],
    i: int,
    pixel: NDArray[np.int64],
    lift: float,
    least: float,
) -> float:
    camera = photographs[i].camera
    local = np.linalg.solve(camera.intrinsics, [pixel[0] + 0.5, pixel[1] + 0.5, 1.0])
    direction = camera.world_to_camera[:3, :3].T @ local
    distance = _distances(mesh, camera.center, direction).min()
    if not np.isfinite(distance):
        return float("nan")
    point = camera.center + distance * direction
    colors = []
    for j, other in enumerate(photographs):
        cosine = camera.center @ other.camera.center
        cosine /= np.linalg.norm(camera.center) * np.linalg.norm(other.camera.center)
        if j == i or other.take != photographs[i].take or np.degrees(np.arccos(np.clip(cosine, -1, 1))) < least:
            continue
        x, y, depth = other.camera.intrinsics @ (other.camera.world_to_camera @ [*point, 1.0])[:3]
        column, row = int(x // depth), int(y // depth)
        if not (0 <= column < other.camera.width and 0 <= row < other.camera.height and other.valid[row, column]):
            continue
        toward = (other.camera.center - point) / np.linalg.norm(other.camera.center - point)
        if not np.isfinite(_distances(mesh, point + lift * toward, toward)).any():
            colors.append(other.colors[row, column])
    if len(colors) < 2:
        return float("nan")
    return float(((np.mean(colors, axis=0) - photographs[i].colors[pixel[1], pixel[0]]) ** 2).sum())


def _distances(mesh: trimesh.Trimesh, origin: Array, direction: Array) -> Array:
    """To each triangle along a ray (Möller and Trumbore 1997); infinite for those that it misses."""
    a, b, c = mesh.triangles.transpose(1, 0, 2)
    edges, normal = (b - a, c - a), np.cross(b - a, c - a)
    determinant = -(normal @ direction)
    with np.errstate(divide="ignore", invalid="ignore"):
        moment = np.cross(origin - a, direction)
        u, v = (edges[1] * moment).sum(axis=1) / determinant, -(edges[0] * moment).sum(axis=1) / determinant
        distance = (normal * (origin - a)).sum(axis=1) / determinant
    return np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 0), distance, np.inf)


def test_photographs_are_compared_with_equal_exposures() -> None:
    """Of a painted block, with factors of up to two stops: corrected ones predict each other as equal ones do."""
    capture = photographed(block(), painted)
    mesh = block().subdivide().subdivide()
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    arrays = vertices, vertex_normals(vertices, faces), faces
    assert exposure_corrections(*arrays, capture) is None, "nothing is changed where all are equal"
    factors = np.exp2(np.random.default_rng(1).uniform(-2, 0, len(capture.views)))

    def darker(view: View, factor: float) -> View:
        pixels = view.pixels()
        return replace(view, read=lambda: replace(pixels, color_linear=pixels.color_linear * np.float32(factor)))

    views = tuple(darker(view, float(factor)) for view, factor in zip(capture.views, factors, strict=True))
    changed = replace(capture, views=views)
    corrections = exposure_corrections(*arrays, changed)
    assert corrections is not None
    equal, dark = blurred_photographs(capture, 0.02), blurred_photographs(changed, 0.02)
    corrected = [each.multiplied(row) for each, row in zip(dark, corrections, strict=True)]
    points = np.asarray(trimesh.sample.sample_surface(block(), 1000, seed=0)[0])
    surface = MeshQueries(vertices, faces)

    def variance(photographs: list[BlurredPhotograph]) -> float:
        return float(color_variance(points, surface, photographs, 0.02)[0].mean())

    assert variance(dark) > 2 * variance(equal)  # 2.4
    assert variance(corrected) < 1.2 * variance(equal)


def test_variance_is_pooled_within_takes() -> None:
    first = photographed(block(), painted, take="a")
    darker = photographed(block(), lambda points, toward: 0.5 * painted(points, toward), take="b")
    capture = replace(first, views=first.views + darker.views)
    queries = MeshQueries(np.asarray(block().vertices), np.asarray(block().faces))
    points, _ = trimesh.sample.sample_surface(block(), 500, seed=1)
    together, count = color_variance(np.asarray(points), queries, blurred_photographs(capture, 0.02), 0.03)
    one, half = color_variance(np.asarray(points), queries, blurred_photographs(first, 0.02), 0.03)
    seen = half >= 4
    assert seen.mean() > 0.9 and (count[seen] == 2 * half[seen]).all()
    assert np.isfinite(together).all() and np.median(together[seen]) < 2 * np.median(one[seen])


def solid() -> Volume:
    """A box of 24 × 20 × 24 voxels in one of 32³."""
    place = np.stack(np.meshgrid(*[np.arange(32.0)] * 3, indexing="ij"), axis=-1)
    inside = np.minimum(place - [4, 6, 4], [27, 25, 27] - place).min(axis=-1) + 0.5
    return Volume(np.clip(inside, -4, 4).astype(np.float32) * 0.1, np.array([1.0, 2.0, 3.0]), 0.1)


def lid_of_the_box(half: int) -> Opening:
    region = np.zeros((40, 40), bool)
    region[20 - half : 20 + half + 1, 20 - half : 20 + half + 1] = True
    axes = np.array([[1.0, 0, 0], [0, 0, 1.0]])
    return Opening(axes, np.array([0.0, 1.0, 0.0]), 25.0, np.array([15.5 - 20, 15.5 - 20]), region)


def test_a_sunk_opening_is_a_well_with_walls() -> None:
    volume, opening = solid(), lid_of_the_box(6)
    wall = wall_distance(Solid.of(volume.values > 0), opening)
    assert reach(volume.values > 0, opening) == 19
    shallow, deep = (sunk(volume, volume, opening, depth, wall) for depth in (8.0, 100.0))
    assert (shallow.values <= volume.values).all() and (deep.values <= shallow.values).all()
    middle = shallow.values[15, :, 15]
    assert (middle[18:26] < 0).all() and (middle[7:17] > 0).all()
    bottom = np.flatnonzero(deep.values[15, :, 15] > 0)
    assert bottom.tolist() == list(range(6, 6 + len(bottom))) and WALL - 1 <= len(bottom) <= WALL + 1
    assert (deep.values[5:9, 15, 15] > 0).all(), "the columns beside the opening stay"
    fine = Volume(volume.values.repeat(2, 0).repeat(2, 1).repeat(2, 2), volume.origin - 0.025, 0.05)
    carved = sunk(fine, volume, opening, 8.0, wall)
    assert (carved.values[30, 38:50, 30] < 0).all() and (carved.values[30, 16:32, 30] > 0).all()


def test_a_rounded_floor_is_a_quarter_of_an_ellipse() -> None:
    opening = replace(lid_of_the_box(10), rounding=1.0)
    distance = np.array([-1.0, 0.0, 5.5, 11.0, 20.0])
    assert opening.floor(distance) == pytest.approx([0, 0, np.sqrt(0.75), 1, 1])
    assert replace(opening, rounding=0.5).floor(distance) == pytest.approx([0, 0, 1, 1, 1])
    assert lid_of_the_box(10).floor(distance) == pytest.approx(np.ones(5))
    volume = solid()
    wall = wall_distance(Solid.of(volume.values > 0), opening)
    straight, rounded = (sunk(volume, volume, each, 10.0, wall) for each in (lid_of_the_box(10), opening))
    assert (rounded.values >= straight.values).all()
    middle, beside = (
        [int(np.flatnonzero(each.values[column, 7:, 15] > 0).max()) for each in (straight, rounded)]
        for column in (15, 7)
    )
    assert abs(middle[0] - middle[1]) <= 1, "the floor in the middle is as deep"
    assert beside[0] == middle[0] < beside[1] - 2


def opposite(opening: Opening) -> Opening:
    """The same region on the other side of the box."""
    return replace(opening, normal=-opening.normal, level=-6.0)


def test_hollows_that_meet_are_a_hole() -> None:
    volume, above = solid(), lid_of_the_box(6)
    below, closed = opposite(above), Solid.of(volume.values > 0)
    first = sunk(volume, volume, above, 100.0, wall_distance(closed, above))
    hole = sunk(first, volume, below, 100.0, wall_distance(closed, below))
    assert (hole.values[15, :, 15] < 0).all() and (hole.values[5:9, 15, 15] > 0).all()
    membrane = sunk(first, volume, below, 100.0, wall_distance(Solid.of(first.values > 0), below))
    assert (membrane.values[15, :, 15] > 0).any(), "a wall to the first hollow closes the hole"


@pytest.mark.parametrize(("width", "is_wall"), [(4, False), (12, True)])
def test_a_narrow_tunnel_of_the_hull_is_no_wall(width: int, is_wall: bool) -> None:
    volume, opening = solid(), lid_of_the_box(9)
    tunnel = slice(16 - width // 2, 16 + width // 2)
    values = volume.values.copy()
    values[tunnel, :, tunnel] = -0.1
    pierced = replace(volume, values=values)
    carved = sunk(pierced, pierced, opening, 100.0, wall_distance(Solid.of(values > 0), opening))
    around = carved.values[16 - width // 2 - 1, 15, 15]
    assert (around > 0) == is_wall


@pytest.mark.parametrize(
    ("depth", "explained", "from_far", "is_confirmed"),
    [(9, 0.55, 0.4, True), (9, 0.45, 0.4, False), (4, 0.55, 0.4, False), (4, 0.7, 0.65, True), (4, 0.7, 0.5, False)],
)
def test_a_flat_hollow_must_explain_more(depth: float, explained: float, from_far: float, is_confirmed: bool) -> None:
    wall = np.zeros((1, 1, 1))
    hollow = search.Hollow(lid_of_the_box(6), depth, wall, 0.1, -1.0, explained, from_far, 4.0, 16)
    assert hollow.is_confirmed == is_confirmed
    assert not replace(hollow, gain=1.0).is_confirmed
    assert not replace(hollow, explained_before=0.45).is_confirmed, "the surface before it explains nearly as much"
    assert not replace(hollow, explained_by_reflection=0.45).is_confirmed, "so do its reflections"


def test_an_opening_like_a_rejected_one_is_not_tried_again_and_a_hole_in_it_is() -> None:
    opening, rejected = lid_of_the_box(6), lid_of_the_box(7)
    assert outline_search.is_nearly(opening, rejected) and outline_search.is_nearly(rejected, opening)
    assert not outline_search.is_nearly(lid_of_the_box(3), rejected)
    assert not outline_search.is_nearly(opposite(opening), rejected)
    assert not outline_search.is_nearly(replace(opening, level=opening.level - 10), rejected)


@pytest.mark.parametrize("thickness", [0, 1, 2])
def test_what_is_thin_has_no_hollow(thickness: int) -> None:
    values = np.full((32, 32, 32), -0.3, np.float32)
    values[4:28, 15 : 15 + thickness, 4:28] = 0.02
    photographs = blurred_photographs(photographed(block(), painted, count=8), 0.02)
    assert find_hollows(Volume(values, np.full(3, -1.55), 0.1), photographs, 0, 1) == []


def test_outlines_move_sector_by_sector() -> None:
    opening = lid_of_the_box(6)
    sectors = opening.sectors(12)
    assert set(sectors[opening.region]) == set(range(12))
    larger = opening.moved(sectors, [3], 2)
    changed = larger.region & ~opening.region
    assert changed.any() and (sectors[changed] == 3).all()
    assert not (opening.moved(sectors, [3], -2).region & ~opening.region).any()
    grown = opening.grown(3)
    points = np.argwhere(np.ones((32, 1, 32))).astype(float)
    assert (grown.contains(points) >= opening.contains(points)).all()
    distance = opening.distance(points)
    clear = np.abs(distance) > 0.6
    assert clear.mean() > 0.9 and ((distance > 0) == opening.contains(points))[clear].all()


def test_openings_are_flat_parts_of_high_variance() -> None:
    volume = solid()
    cells = surface_cells(volume.values > 0)
    lid = (cells[:, 1] == 25) & (np.abs(cells[:, [0, 2]] - 15.5) < 7).all(axis=1)
    known = np.ones(len(cells), bool)
    openings = find_openings(volume, cells, np.where(lid, 1.0, 0.01), known)
    nearest = min(openings, key=lambda opening: abs(int(opening.region.sum()) - int(lid.sum())))
    assert nearest.normal @ [0, 1, 0] > 0.99 and abs(nearest.level - 25) < 0.6
    assert nearest.region.sum() == pytest.approx(lid.sum(), rel=0.35)
    assert find_openings(volume, cells, np.zeros(len(cells)), np.zeros(len(cells), bool)) == []


@pytest.mark.parametrize(("name", "value"), [("max_hollows", -1), ("max_photographs", 5), ("max_resolution", 0)])
def test_options_have_limits(name: str, value: int) -> None:
    with pytest.raises(ConfigError, match=f"option '{name}' is {value}; it must be"):
        build_options(HollowsOptions, {name: value}, "initializer 'hollows'")
