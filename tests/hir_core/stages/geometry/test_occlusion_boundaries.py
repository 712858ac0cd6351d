"""Occlusion boundaries move to where photographs show them, and stay where they are right or where there are none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from hir_core.capture import Camera, Capture, Pixels, View
from hir_core.config import GeometrySettings
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.plugins.manager import PluginManager
from hir_core.run.stage_context import StageContext
from hir_core.scene import Mesh
from hir_core.stages.geometry.occlusion_boundaries import boundary_refinement
from hir_core.stages.geometry.occlusion_boundaries.boundary_refinement import refine_occlusion_boundaries
from hir_core.stages.geometry.occlusion_boundaries.boundary_report import (
    OcclusionBoundariesReport,
    OcclusionBoundariesSkipped,
)
from hir_core.stages.geometry.occlusion_boundaries.boundary_samples import EdgeFaces, find_boundaries
from hir_core.stages.geometry.occlusion_boundaries.predicted_colors import VertexColors
from hir_core.stages.geometry.occlusion_boundaries.view_photographs import ViewPhotographs
from hir_core.stages.geometry.photo_consistency.photo_residuals import neighbouring_views, ray_structure
from hir_core.stages.held_out_views import held_out_for_geometry
from hir_plugins.geometry_renderers.contour import Contour
from hir_plugins.geometry_renderers.options import ContourOptions
from tests.fixtures.meshes import Faces, Positions, around, camera, capture_of, icosphere, mesh_of

pytest.importorskip("open3d")
pytest.importorskip("cholespy")

OUTER, INNER, WRONG = 0.8, 0.55, 0.62
"""Radii of a cup's wall, and of its inside in the mesh that is to be refined."""


class _Photograph:
    def __init__(self, color: np.ndarray, mask: np.ndarray) -> None:
        self.pixels = Pixels(color.astype(np.float32), mask, np.zeros(mask.shape, bool))

    def __call__(self) -> Pixels:
        return self.pixels


def _cup(inner: float, around_count: int = 64) -> tuple[Positions, Faces, np.ndarray]:
    """A closed surface of revolution about z, and its faces' colours: outside, rim and inside differ."""
    outside = [(0.0, -0.7), (0.4, -0.7), (OUTER, -0.7), *((OUTER, z) for z in np.linspace(-0.56, 0.6, 9))]
    rim = [(r, 0.6) for r in np.linspace(OUTER, inner, 4)[1:]]
    inside = [*((inner, z) for z in np.linspace(0.48, -0.4, 8)), (0.3, -0.4), (0.0, -0.4)]
    profile = np.array(outside + rim + inside)
    part = np.array([0] * (len(outside) - 1) + [1] * len(rim) + [2] * len(inside))
    angle = np.arange(around_count) * 2 * np.pi / around_count
    rings = np.stack(
        [profile[:, :1] * np.cos(angle), profile[:, :1] * np.sin(angle), profile[:, 1:] + 0 * angle], axis=-1
    ).reshape(-1, 3)
    faces, parts = [], []
    for i in range(len(profile) - 1):
        for j in range(around_count):
            a, b = i * around_count + j, i * around_count + (j + 1) % around_count
            c, d = a + around_count, b + around_count
            faces += [] if profile[i, 0] == 0 else [(a, b, d)]
            faces += [] if profile[i + 1, 0] == 0 else [(a, d, c)]
            parts += [part[i]] * (int(profile[i, 0] > 0) + int(profile[i + 1, 0] > 0))
    # the rings of radius 0 are one vertex each
    first, last = 0, (len(profile) - 1) * around_count
    merged = np.where(np.arange(len(rings)) < around_count, first, np.arange(len(rings)))
    merged = np.where(np.arange(len(rings)) >= last, last, merged)
    used, index = np.unique(merged[np.array(faces)], return_inverse=True)
    return rings[used], index.reshape(-1, 3), np.array(parts)


def _from_above(count: int, size: int) -> list[Camera]:
    """Cameras that look into the cup, 20° to 65° above its rim."""
    azimuth, height = np.arange(count) * 2.4, np.radians(np.linspace(20, 65, count))
    eyes = 3.2 * np.stack([np.cos(height) * np.cos(azimuth), np.cos(height) * np.sin(azimuth), np.sin(height)], axis=1)
    return [camera(size, (float(x), float(y), float(z))) for x, y, z in eyes]


def _photographed(positions: Positions, faces: Faces, parts: np.ndarray, cameras: list[Camera]) -> Capture:
    """Unlit photographs, 16 rays a pixel."""
    size = cameras[0].width
    colors = np.array([[0.6, 0.2, 0.1], [0.5, 0.4, 0.2], [0.05, 0.1, 0.3]])
    capture = capture_of(positions, faces, cameras)
    tracer = MeshQueries(positions.astype(np.float32), faces)
    changed = []
    for view, shot in zip(capture.views, cameras, strict=True):
        y, x = (np.mgrid[: 4 * size, : 4 * size] + 0.5) / 4
        origins, directions = shot.rays(np.stack([x.ravel(), y.ravel()], axis=1))
        face = tracer.first_faces(origins.astype(np.float32), directions.astype(np.float32))
        color = np.where(face[:, None] >= 0, colors[parts[np.maximum(face, 0)]], 0.0)
        image = color.reshape(size, 4, size, 4, 3).mean(axis=(1, 3))
        changed.append(replace(view, read=_Photograph(image, view.pixels().mask)))
    return replace(capture, views=tuple(changed))


def _refined(mesh: Mesh, capture: Capture, tmp_path, **changes):  # type: ignore[no-untyped-def]
    renderer = Contour(ContourOptions())
    targets = renderer.prepare(capture.views)
    areas = targets.areas.double()

    def iou(moved: Mesh, views: list[int]) -> torch.Tensor:
        area, overlap = renderer.overlap(moved, targets[views])
        return overlap / (area + areas[views] - overlap)

    held_out = held_out_for_geometry(len(capture.views), 0.08)
    settings = GeometrySettings(**({"occlusion_boundary_iterations": 200} | changes))
    return refine_occlusion_boundaries(mesh, capture, iou, held_out, settings, StageContext(PluginManager(), tmp_path))


def _inner_radius(mesh: Mesh) -> float:
    """Of the opening, a little below the rim: where horizontal rays from the axis meet the wall."""
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    directions = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    origins = np.tile([0.0, 0.0, 0.52], (60, 1))
    tracer = ray_structure(mesh)
    return float(tracer.first_distances(origins.astype(np.float32), directions.astype(np.float32)).mean())


@pytest.fixture(scope="module")
def cup_capture() -> Capture:
    return _photographed(*_cup(INNER), _from_above(36, 80))


@pytest.mark.slow
def test_the_rim_of_a_cup_moves_to_where_photographs_show_it(cup_capture: Capture, tmp_path) -> None:  # type: ignore[no-untyped-def]
    """No outline shows the inner edge of a rim. It starts three pixels off."""
    positions, faces, _ = _cup(WRONG)
    mesh, report = _refined(mesh_of(positions, faces), cup_capture, tmp_path)
    assert isinstance(report, OcclusionBoundariesReport) and report.accepted
    assert report.disagreement[1] < 0.8 * report.disagreement[0]
    assert abs(_inner_radius(mesh) - INNER) < 0.2 * (WRONG - INNER)  # 0.09
    assert torch.isfinite(mesh.positions).all()


@pytest.mark.slow
def test_exposures_that_differ_do_not_move_boundaries(cup_capture: Capture, tmp_path) -> None:  # type: ignore[no-untyped-def]
    """Up to a stop darker or brighter; predictions by the other photographs would be wrong by as much."""
    factors = np.exp2(np.random.default_rng(0).uniform(-1, 1, (len(cup_capture.views), 1, 1)))

    def changed(view: View, factor: np.ndarray) -> View:
        pixels = view.pixels()
        return replace(view, read=_Photograph((pixels.color_linear * factor).clip(0, 1), pixels.mask))

    views = tuple(changed(view, factor) for view, factor in zip(cup_capture.views, factors, strict=True))
    positions, faces, _ = _cup(WRONG)
    mesh, report = _refined(mesh_of(positions, faces), replace(cup_capture, views=views), tmp_path)
    assert isinstance(report, OcclusionBoundariesReport) and report.accepted
    assert abs(_inner_radius(mesh) - INNER) < 0.2 * (WRONG - INNER)


def test_right_boundaries_stay(cup_capture: Capture, tmp_path) -> None:  # type: ignore[no-untyped-def]
    positions, faces, _ = _cup(INNER)
    before = mesh_of(positions, faces)
    mesh, _ = _refined(before, cup_capture, tmp_path)
    assert abs(_inner_radius(mesh) - INNER) < 0.003  # 0.0006, of which the facets are 0.0004


def test_boundaries_that_judging_views_do_not_confirm_early_are_left(
    cup_capture: Capture, tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setattr(boundary_refinement, "LEAST_EARLY_GAIN", 1.0)
    positions, faces, _ = _cup(WRONG)
    before = mesh_of(positions, faces)
    mesh, report = _refined(before, cup_capture, tmp_path)
    assert isinstance(report, OcclusionBoundariesSkipped) and "after 36 steps" in report.reason
    assert mesh is before
    assert float((mesh.positions - before.positions).norm(dim=1).median()) < 0.001


def test_nothing_moves_where_no_part_hides_another(tmp_path) -> None:  # type: ignore[no-untyped-def]
    positions, faces = icosphere(3)
    before = mesh_of(positions, faces)
    capture = _photographed(positions, faces, np.zeros(len(faces), int), around(24, 48))
    mesh, report = _refined(before, capture, tmp_path)
    assert report == OcclusionBoundariesSkipped("no part of the object hides another in any view")
    assert mesh is before


def test_few_views_decide_nothing(tmp_path) -> None:  # type: ignore[no-untyped-def]
    positions, faces, parts = _cup(INNER, 24)
    before = mesh_of(positions, faces)
    mesh, report = _refined(before, _photographed(positions, faces, parts, around(3, 48)), tmp_path)
    assert isinstance(report, OcclusionBoundariesSkipped) and mesh is before


def _two_squares(side: float) -> tuple[Positions, Faces]:
    """A square at z = 0.5 in front of a larger one at z = −0.5, as thin boxes, divided into small triangles."""
    import trimesh

    boxes = []
    for size, height in ((side, 0.5), (4.0, -0.5)):
        box = trimesh.creation.box((size, size, 0.02)).apply_translation((0, 0, height))
        boxes.append(box.subdivide().subdivide())
    both = trimesh.util.concatenate(boxes)
    return np.asarray(both.vertices), np.asarray(both.faces)


def test_the_boundary_integral_is_the_derivative_of_the_visible_area() -> None:
    """A growing square: ∮ (v·n) dl is the change of the area that it covers; dl adds up to its outline."""
    size, side = 128, 0.7
    shot = camera(size, (0.0, 0.0, 3.0))
    capture = _photographed(*_two_squares(side), np.zeros(10_000, int), around(1, 8))
    photographs = ViewPhotographs.of([replace(capture.views[0], camera=shot, read=_flat(size))], 1)
    positions, faces = _two_squares(side)
    mesh = mesh_of(positions, faces, torch.float64, grad=True)
    samples = find_boundaries(mesh, EdgeFaces.of(mesh.topology), photographs, [0], ray_structure(mesh))
    # the nearer face of the box, which is the one whose outline is seen
    focal, depth = float(shot.intrinsics[0, 0]), 3.0 - 0.51
    expected_outline = 4 * side * focal / depth
    assert float(samples.length.sum()) == pytest.approx(expected_outline, rel=1e-6)
    moved = samples.outward_motion(mesh.positions, photographs)
    (gradient,) = torch.autograd.grad((moved * samples.length).sum(), mesh.positions)
    growth = torch.as_tensor(positions * [1.0, 1.0, 0.0] * (positions[:, 2:] > 0))
    area = lambda s: (side * (1 + s) * focal / depth) ** 2  # noqa: E731
    expected = (area(1e-5) - area(-1e-5)) / 2e-5
    assert float((gradient * growth).sum()) == pytest.approx(expected, rel=1e-6)
    center = torch.tensor([size / 2, size / 2], dtype=torch.float64)
    assert bool(((samples.pixels - center) * samples.outward).sum(dim=1).gt(0).all())


def _flat(size: int) -> _Photograph:
    return _Photograph(np.full((size, size, 3), 0.5), np.ones((size, size), np.float32))


def test_colours_at_the_border_and_of_unknown_pixels_are_finite() -> None:
    image = np.full((8, 8, 3), 0.5)
    image[2, 2] = np.nan
    capture = _photographed(*_cup(INNER, 12), around(1, 8))
    view = replace(capture.views[0], read=_Photograph(image, np.ones((8, 8), np.float32)))
    photographs = ViewPhotographs.of([view], 1)
    pixels = torch.tensor([[4.0, 4.0], [2.5, 2.5], [0.2, 4.0], [-3.0, 50.0], [torch.nan, 1.0]], dtype=torch.float64)
    color, covered = photographs.colors_at(torch.zeros(5, dtype=torch.long), pixels)
    assert torch.isfinite(color).all()
    assert covered.tolist() == [True, False, False, False, False]
    assert color[0, 0] == pytest.approx(0.735, abs=0.005)  # 0.5 in sRGB


def test_a_view_is_predicted_from_the_others(cup_capture: Capture) -> None:
    positions, faces, parts = _cup(INNER)
    mesh = mesh_of(positions, faces)
    photographs = ViewPhotographs.of(cup_capture.views, 1)
    everything = list(range(len(cup_capture.views)))
    near = neighbouring_views(cup_capture.cameras, everything)
    colors = VertexColors(mesh, photographs, everything, near, ray_structure(mesh))
    predicted, known = colors.predicted([3])
    outside = np.unique(faces[(parts == 0)])
    outside = outside[np.abs(positions[outside, 2]) < 0.4]
    towards = torch.from_numpy(cup_capture.cameras[3].center).float() - mesh.positions[outside]
    turned = (towards * mesh.normals[outside]).sum(dim=1) > 0.5 * towards.norm(dim=1)
    rows = torch.from_numpy(outside)[known[outside, 0] & turned]
    expected = torch.tensor([0.798, 0.485, 0.349])  # of the wall, in sRGB
    assert len(rows) > 50 and float((predicted[rows, 0] - expected).abs().max()) < 0.01
    assert torch.isfinite(colors.variance()).all()
    # far from every boundary photographs agree
    assert float(colors.variance()[rows].median()) < 1e-3
