"""Meshes, masks and cameras that break other renderers: finite values and gradients, and the right answer where there
is one.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hir_core.scene.silhouette_targets import intersection_over_union
from hir_plugins.geometry_renderers.contour import Contour
from hir_plugins.geometry_renderers.options import ContourOptions, SoftSilhouetteOptions
from hir_plugins.geometry_renderers.soft_silhouette import SoftSilhouette
from tests.fixtures.meshes import bumpy_sphere, camera, icosphere, mesh_of, targets_of

SPHERE = icosphere(2)


def _far() -> tuple[np.ndarray, np.ndarray]:
    return SPHERE[0] + [50.0, 0, 0], SPHERE[1]


def _point() -> tuple[np.ndarray, np.ndarray]:
    return np.zeros((3, 3)), np.array([[0, 1, 2]])


def _repeated_corner() -> tuple[np.ndarray, np.ndarray]:
    return SPHERE[0], np.concatenate([SPHERE[1], [[0, 0, 5], [3, 3, 3]]])


def _needles() -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(1)
    start, way = random.normal(size=(40, 3)) * 0.3, random.normal(size=(40, 3))
    corners = np.stack([start, start + way, start + way * 1.0000001 + 1e-7], axis=1)
    return corners.reshape(-1, 3), np.arange(120).reshape(-1, 3)


def _doubled() -> tuple[np.ndarray, np.ndarray]:
    return np.concatenate([SPHERE[0], SPHERE[0]]), np.concatenate([SPHERE[1], SPHERE[1] + len(SPHERE[0])])


def _soup() -> tuple[np.ndarray, np.ndarray]:
    return SPHERE[0][SPHERE[1]].reshape(-1, 3), np.arange(3 * len(SPHERE[1])).reshape(-1, 3)


def _fan() -> tuple[np.ndarray, np.ndarray]:
    angle = np.arange(7)
    rim = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1) * 0.5
    return np.concatenate([[[0, 0, -0.5], [0, 0, 0.5]], rim]), np.stack([0 * angle, 0 * angle + 1, angle + 2], axis=1)


def _around_camera() -> tuple[np.ndarray, np.ndarray]:
    return SPHERE[0] * 3.0 + 1e-3, SPHERE[1]


def _through_camera() -> tuple[np.ndarray, np.ndarray]:
    return np.array([[-1, 0, 3.0], [1, 0.1, 3.0], [0, -0.3, -5.0]]), np.array([[0, 1, 2]])


MESHES = {
    "empty": lambda: (np.zeros((0, 3)), np.zeros((0, 3), int)),
    "no triangles": lambda: (SPHERE[0], np.zeros((0, 3), int)),
    "outside every view": _far,
    "one triangle": lambda: (np.eye(3), np.array([[0, 1, 2]])),
    "a point": _point,
    "repeated corners": _repeated_corner,
    "needles": _needles,
    "every vertex twice": _doubled,
    "soup": _soup,
    "seven triangles on one edge": _fan,
    "open": lambda: (SPHERE[0], SPHERE[1][:200]),
    "around the camera": _around_camera,
    "through the camera": _through_camera,
}
MASKS = {"empty": 0.0, "half": 0.5, "full": 1.0}


@pytest.mark.parametrize("renderer", ["contour", "soft_silhouette"])
@pytest.mark.parametrize("mask", MASKS)
@pytest.mark.parametrize("name", MESHES)
def test_value_and_gradient_are_finite(name: str, mask: str, renderer: str) -> None:
    made = Contour(ContourOptions()) if renderer == "contour" else SoftSilhouette(SoftSilhouetteOptions())
    views = [camera(24, (0.2, 0.3, 3.0)), camera(1, (3.0, 0.1, 0.2)), camera(24, (0.1, -3.0, 0.2), height=9)]
    mesh = mesh_of(*MESHES[name](), grad=True)
    targets = targets_of(views, [np.full((v.height, v.width), MASKS[mask]) for v in views])
    area, shared = made.overlap(mesh, targets)
    iou = intersection_over_union(area, shared, targets.areas)
    frame = torch.tensor([float(v.width * v.height) for v in views], dtype=area.dtype)
    assert bool(((area >= -1e-9) & (area <= frame * (1 + 1e-6) + 1e-9)).all())
    assert torch.allclose(shared, area * MASKS[mask], atol=1e-4)
    assert bool(torch.isfinite(iou).all())
    assert bool(torch.isfinite(made.render(mesh, views)).all())
    if iou.requires_grad:
        iou.sum().backward()
    if mesh.positions.grad is not None:
        assert bool(torch.isfinite(mesh.positions.grad).all())


def test_doubled_surface_is_the_surface() -> None:
    contour, targets = Contour(ContourOptions()), targets_of([camera(64, (0.2, 0.3, 3.0))])
    single, double, soup = (contour.overlap(mesh_of(*m), targets)[0].item() for m in (SPHERE, _doubled(), _soup()))
    assert double == pytest.approx(single, rel=1e-12)
    assert soup == pytest.approx(single, rel=1e-12)


@pytest.mark.parametrize("scale", [1e-3, 1e4])
def test_the_scale_of_the_scene_changes_nothing(scale: float) -> None:
    positions, faces = bumpy_sphere(3)
    contour = Contour(ContourOptions())
    results = []
    for s in (1.0, scale):
        mesh = mesh_of(positions * s, faces, torch.float64, grad=True)
        area, _ = contour.overlap(mesh, targets_of([camera(128, (3.0 * s, 1.0 * s, 0.5 * s))]))
        area.sum().backward()
        results.append((area.item(), (mesh.positions.grad * s).numpy()))
    assert results[1][0] == pytest.approx(results[0][0], rel=1e-9)
    assert results[1][1] == pytest.approx(results[0][1], rel=1e-5, abs=1e-5 * np.abs(results[0][1]).max())


def test_a_scene_far_from_the_origin_keeps_its_sub_pixels() -> None:
    positions, faces = bumpy_sphere(3)
    view = camera(128, (3.0, 1.0, 0.5))
    shift = np.eye(4)
    shift[:3, 3] = [1e4, -2e4, 3e4]
    contour = Contour(ContourOptions())
    here = contour.overlap(mesh_of(positions, faces, torch.float64), targets_of([view]))[0]
    there = contour.overlap(
        mesh_of(positions + shift[:3, 3], faces, torch.float64), targets_of([view.transformed(shift)])
    )[0]
    assert there.item() == pytest.approx(here.item(), rel=1e-6)


@pytest.mark.slow
def test_five_hundred_thousand_triangles() -> None:
    positions, faces = icosphere(8)
    triangles = faces[:500_000]
    mesh = mesh_of(positions, triangles, grad=True)
    area, _ = Contour(ContourOptions()).overlap(mesh, targets_of([camera(512, (0.3, 0.2, 3.0))]))
    area.sum().backward()
    assert bool(torch.isfinite(mesh.positions.grad).all()) and area.item() > 0
