"""Derivatives of `contour` against central differences of exact float64 polygon areas (steps of 1e-5 of the object)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from hir_core.capture import Camera
from hir_plugins.geometry_renderers.contour import Contour
from hir_plugins.geometry_renderers.options import ContourOptions
from tests.fixtures import exact_polygons as polygons
from tests.fixtures.meshes import bumpy_sphere, camera, facing, mesh_of, smooth_directions, targets_of, torus

EYES = ((3.0, 1.0, 0.5), (-1.0, 0.4, 3.2))


def slope(value: Callable[[np.ndarray], float], positions: np.ndarray, direction: np.ndarray) -> float:
    h = 1e-5
    return (value(positions + h * direction) - value(positions - h * direction)) / (2 * h)


def relative_errors(positions: np.ndarray, faces: np.ndarray, size: int, overlap: bool) -> np.ndarray:
    """Errors of directional derivatives, relative to the root mean square of the exact ones."""
    ramp = np.tile((np.arange(size) + 0.5) / size, (size, 1))
    exact, found = [], []
    for eye in EYES:
        view: Camera = camera(size, eye)
        mesh = mesh_of(positions, faces, grad=True)
        result = Contour(ContourOptions()).overlap(mesh, targets_of([view], [ramp]))[int(overlap)]
        result.sum().backward()
        gradient = mesh.positions.grad.double().numpy()
        reference = polygons.ramp_overlap if overlap else polygons.area
        for direction in smooth_directions(positions, 2, seed=5):
            exact.append(slope(lambda p, v=view, r=reference: r(p, faces, v), positions, direction))
            found.append(float((gradient * direction).sum()))
    return (np.array(found) - exact) / np.sqrt(np.mean(np.square(exact)))


@pytest.mark.parametrize("overlap", [False, True], ids=["area", "overlap"])
@pytest.mark.parametrize("make", [lambda: bumpy_sphere(4), torus], ids=["bumpy 5k", "torus"])
def test_gradient_is_within_one_percent_of_exact_polygons(make, overlap: bool) -> None:
    errors = relative_errors(*make(), size=512, overlap=overlap)
    assert np.sqrt(np.mean(errors**2)) < 0.01


@pytest.mark.slow
def test_gradient_is_within_one_percent_at_82k_triangles() -> None:
    assert np.sqrt(np.mean(relative_errors(*bumpy_sphere(6), size=512, overlap=False) ** 2)) < 0.01


def test_gradient_of_a_square_is_its_perimeter() -> None:
    corners = np.array([[2.3, 3.1, 0], [12.6, 3.1, 0], [12.6, 9.7, 0], [2.3, 9.7, 0]])
    mesh = mesh_of(corners, np.array([[0, 1, 2], [0, 2, 3]]), torch.float64, grad=True)
    area, _ = Contour(ContourOptions(lines_per_pixel=64)).overlap(mesh, targets_of([facing(16)]))
    area.sum().backward()
    # moving the right side by dx adds its height; each of its two corners carries half of it
    expected = 0.5 * np.array([[-6.6, -10.3], [6.6, -10.3], [6.6, 10.3], [-6.6, 10.3]])
    assert mesh.positions.grad[:, :2].numpy() == pytest.approx(expected, rel=0.02)


def test_hidden_edges_get_nothing() -> None:
    positions = np.array([[0, 0, 0], [16, 0, 0], [0, 16, 0], [16, 16, 0], [4, 4, 1], [9, 5, 1], [5, 10, 1]], float)
    mesh = mesh_of(positions, np.array([[0, 1, 2], [1, 3, 2], [4, 5, 6]]), grad=True)
    # the small triangle lies behind the square, of which the frame cuts the rim
    Contour(ContourOptions()).overlap(mesh, targets_of([facing(12)]))[0].sum().backward()
    assert float(mesh.positions.grad[4:].abs().max()) == 0.0


def test_render_and_overlap_move_alike() -> None:
    positions, faces = bumpy_sphere(3)
    view = camera(128, EYES[0])
    contour = Contour(ContourOptions(lines_per_pixel=16, render_lines=16))
    gradients = []
    for value in (lambda m: contour.render(m, [view]).sum(), lambda m: contour.overlap(m, targets_of([view]))[0].sum()):
        mesh = mesh_of(positions, faces, torch.float64, grad=True)
        value(mesh).backward()
        gradients.append(mesh.positions.grad.numpy())
    slopes = np.array([[(g * d).sum() for g in gradients] for d in smooth_directions(positions, 4, seed=2)])
    # two quadratures of one integral, of 16 lines a pixel
    assert np.abs(slopes[:, 0] - slopes[:, 1]).max() < 0.01 * np.sqrt(np.mean(slopes**2))
