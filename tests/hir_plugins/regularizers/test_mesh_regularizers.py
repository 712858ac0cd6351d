"""The paper's mesh terms: closed forms, finite differences, invariances."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from hir_core.plugins import NoOptions
from hir_core.plugins.interfaces import Regularizer
from hir_core.scene import Mesh, Scene
from hir_plugins.regularizers.edge_length import EdgeLength
from hir_plugins.regularizers.laplacian import Laplacian
from hir_plugins.regularizers.mesh_options import EdgeLengthOptions, LaplacianOptions
from hir_plugins.regularizers.normal_consistency import NormalConsistency
from tests.fixtures.meshes import bumpy_sphere, icosphere, mesh_of

TERMS: dict[str, Callable[[], Regularizer]] = {
    "laplacian": lambda: Laplacian(LaplacianOptions()),
    "laplacian cotangent": lambda: Laplacian(LaplacianOptions(cotangent=True)),
    "laplacian scale free": lambda: Laplacian(LaplacianOptions(scale_free=True)),
    "bending": lambda: Laplacian(LaplacianOptions(cotangent=True, scale_free=True)),
    "normal_consistency": lambda: NormalConsistency(NoOptions()),
    "edge_length": lambda: EdgeLength(EdgeLengthOptions()),
    "edge_length scale free": lambda: EdgeLength(EdgeLengthOptions(scale_free=True)),
}


def _value(term: Regularizer, mesh: Mesh, at: torch.Tensor | None = None) -> torch.Tensor:
    energy = term.prepare(Scene(mesh))
    return energy(Scene(mesh if at is None else mesh.with_positions(at)))


@pytest.mark.parametrize("name", TERMS)
def test_gradient_matches_finite_differences(name: str) -> None:
    mesh = mesh_of(*bumpy_sphere(1), torch.float64)
    energy = TERMS[name]().prepare(Scene(mesh))
    moved = (mesh.positions * 1.05 + 0.01).requires_grad_(True)
    assert torch.autograd.gradcheck(lambda p: energy(Scene(mesh.with_positions(p))), (moved,), atol=1e-8, rtol=1e-5)


@pytest.mark.parametrize("name", [n for n in TERMS if n in ("bending", "normal_consistency") or "scale free" in n])
@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_scale_free_forms_do_not_know_the_scale(name: str, scale: float) -> None:
    positions, faces = bumpy_sphere(2)
    values = []
    for s in (1.0, scale):
        mesh = mesh_of(positions * s, faces, torch.float64)
        values.append(_value(TERMS[name](), mesh, mesh.positions * torch.tensor([1.1, 1.0, 0.9])).item())
    assert values[1] == pytest.approx(values[0], rel=1e-9)


@pytest.mark.parametrize("name", TERMS)
def test_terms_do_not_change_when_the_scene_is_turned_and_moved(name: str) -> None:
    positions, faces = bumpy_sphere(2)
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    plain = _value(TERMS[name](), mesh_of(positions, faces, torch.float64))
    moved = _value(TERMS[name](), mesh_of(positions @ turn.T + [3.0, -2.0, 5.0], faces, torch.float64))
    assert moved.item() == pytest.approx(plain.item(), rel=1e-9)


def test_paper_values_on_an_octahedron() -> None:
    corners = np.concatenate([np.eye(3), -np.eye(3)])
    faces = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])
    mesh = mesh_of(corners, faces, torch.float64)
    # the mean of each vertex's neighbours is the centre
    assert _value(TERMS["laplacian"](), mesh).item() == pytest.approx(6.0)
    # twelve edges of length √2
    assert _value(TERMS["edge_length"](), mesh).item() == pytest.approx(np.sqrt(24.0))
    # neighbouring normals have cosine 1/3
    assert _value(TERMS["normal_consistency"](), mesh).item() == pytest.approx(12 * (2 / 3) ** 2)


def test_normal_variation_of_a_sphere_is_that_of_calculus() -> None:
    # ∫ |Δx|² = ∫ (2H)² = 4 · 4π, for every sphere
    assert _value(TERMS["bending"](), mesh_of(*icosphere(4), torch.float64)).item() == pytest.approx(
        16 * np.pi, rel=0.02
    )


@pytest.mark.parametrize("name", TERMS)
@pytest.mark.parametrize(
    "mesh",
    [
        (np.zeros((3, 3)), np.array([[0, 1, 2]])),
        (np.zeros((0, 3)), np.zeros((0, 3), int)),
        (np.eye(3), np.array([[0, 0, 1]])),
        (np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0.0]]), np.array([[0, 1, 2]])),
        (np.concatenate([np.eye(3), [[9.0, 9, 9]]]), np.array([[0, 1, 2], [0, 1, 3], [0, 1, 2]])),
    ],
    ids=["a point", "empty", "an edge", "a line", "non-manifold"],
)
def test_broken_meshes_give_finite_values_and_gradients(name: str, mesh: tuple[np.ndarray, np.ndarray]) -> None:
    made = mesh_of(*mesh, grad=True)
    value = _value(TERMS[name](), made)
    assert bool(torch.isfinite(value))
    if value.requires_grad:
        value.backward()
        assert made.positions.grad is None or bool(torch.isfinite(made.positions.grad).all())
