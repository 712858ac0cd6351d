"""Triangles without area, needles, meshes of a picometre and of a light year."""

from __future__ import annotations

import numpy as np
import torch

from hir_core.plugins import NoOptions
from hir_core.scene import Mesh, Scene, Topology
from hir_plugins.initializers.surface.vertex_colors import vertex_normals
from hir_plugins.regularizers.edge_length import EdgeLength
from hir_plugins.regularizers.laplacian import Laplacian, mesh_laplacian
from hir_plugins.regularizers.mesh_options import EdgeLengthOptions, LaplacianOptions
from hir_plugins.regularizers.normal_consistency import NormalConsistency
from tests.stability.case import Case

_ROOF = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.5]])
_FACES = np.array([[0, 1, 2], [1, 3, 2]])


def _mesh(positions: np.ndarray, faces: np.ndarray = _FACES) -> Mesh:
    return Mesh(torch.tensor(np.asarray(positions, np.float32)), Topology(torch.tensor(faces)))


def _normals() -> list[Case]:
    cases = []
    for scale in (1e-12, 1e-15, 1e12, 1e15):
        truth = _unit_normals64(_ROOF * scale)
        cases.append(
            Case(
                "geometry",
                "hir_plugins.regularizers.normal_consistency.NormalConsistency",
                f"a roof of size {scale:g}",
                "the same as at size 1",
                lambda s=scale: _consistency(_ROOF * s),
                lambda s=scale: _plain_consistency(_ROOF * s),
                lambda t=truth: (1 - t[0] @ t[1]) ** 2,
                formula="n = (b−a)×(c−a); n/√(n·n) in float32; (1 − n₁·n₂)²",
            )
        )
    flat = _ROOF.copy()
    flat[3] = flat[1]
    for name, roof in (("a triangle without area", flat), ("all vertices at one point", _ROOF * 0)):
        cases.append(
            Case(
                "geometry",
                "hir_plugins.regularizers.normal_consistency.NormalConsistency",
                f"gradient, {name}",
                "0 values that are not finite",
                lambda r=roof: _bad_gradients(lambda m: NormalConsistency(NoOptions()).prepare(Scene(m))(Scene(m)), r),
                lambda r=roof: _bad_gradients(_torch_consistency, r),
                0.0,
                formula="n/√(n·n), differentiated",
            )
        )
    for scale in (1e-12, 1e-20):
        cases.append(
            Case(
                "geometry",
                "hir_core.scene.Mesh.normals",
                f"a roof of size {scale:g}",
                "unit normals",
                lambda s=scale: _mesh(_ROOF * s).normals.norm(dim=1),
                lambda s=scale: _plain_vertex_normals(_ROOF * s),
                lambda: np.ones(4),
                formula="Σ (b−a)×(c−a), over √(n·n) in float32",
                tolerance=1e-5,
            )
        )
    cases.append(
        Case(
            "geometry",
            "hir_core.scene.Mesh.normals",
            "a vertex that no triangle uses",
            "+Y, not 0/0",
            lambda: _mesh(np.vstack([_ROOF, [[5.0, 5, 5]]])).normals[4],
            lambda: np.zeros(3) / np.linalg.norm(np.zeros(3)),
            lambda: [0.0, 1.0, 0.0],
            formula="n / |n|",
        )
    )
    cases.append(
        Case(
            "initialization",
            "hir_plugins.initializers.surface.vertex_colors.vertex_normals",
            "a triangle without area",
            "0 values that are not finite",
            lambda: float((~np.isfinite(vertex_normals(flat[[1, 2, 3]], np.array([[0, 1, 2]])))).sum()),
            lambda: float((~np.isfinite(np.zeros((3, 3)) / np.linalg.norm(np.zeros((3, 3)), axis=1))).sum()),
            0.0,
            formula="n / |n|",
        )
    )
    return cases


def _unit_normals64(p: np.ndarray) -> np.ndarray:
    n = np.cross(p[_FACES[:, 1]] - p[_FACES[:, 0]], p[_FACES[:, 2]] - p[_FACES[:, 0]])
    return np.asarray(n / np.linalg.norm(n, axis=1, keepdims=True))


def _consistency(positions: np.ndarray) -> torch.Tensor:
    scene = Scene(_mesh(positions))
    return NormalConsistency(NoOptions()).prepare(scene)(scene)


def _plain_consistency(positions: np.ndarray) -> np.float32:
    p = positions.astype(np.float32)
    n = np.cross(p[_FACES[:, 1]] - p[_FACES[:, 0]], p[_FACES[:, 2]] - p[_FACES[:, 0]])
    n = n / np.sqrt((n * n).sum(1, keepdims=True))
    return (1 - (n[0] * n[1]).sum()) ** 2


def _torch_consistency(mesh: Mesh) -> torch.Tensor:
    n = mesh.face_areas_normals
    n = n / (n * n).sum(1, keepdim=True).sqrt()
    return (1 - (n[0] * n[1]).sum()) ** 2


def _plain_vertex_normals(positions: np.ndarray) -> np.ndarray:
    p = positions.astype(np.float32)
    n = np.zeros_like(p)
    np.add.at(
        n, _FACES.ravel(), np.cross(p[_FACES[:, 1]] - p[_FACES[:, 0]], p[_FACES[:, 2]] - p[_FACES[:, 0]]).repeat(3, 0)
    )
    return np.linalg.norm(n / np.sqrt((n * n).sum(1, keepdims=True)), axis=1)


def _bad_gradients(energy, positions: np.ndarray, faces: np.ndarray = _FACES) -> float:  # type: ignore[no-untyped-def]
    mesh = _mesh(positions, faces)
    x = mesh.positions.requires_grad_()
    energy(mesh.with_positions(x)).backward()
    return float((~torch.isfinite(x.grad)).sum())


def _smoothness() -> list[Case]:
    cases = []
    for offset in (1e4, 1e5, 1e6):
        positions = (_ROOF + offset).astype(np.float32)
        matrix = mesh_laplacian(_mesh(_ROOF))[0].to_dense().double().numpy()
        truth = float(((matrix @ (positions.astype(np.float64) - offset)) ** 2).sum())
        cases.append(
            Case(
                "geometry",
                "hir_plugins.regularizers.laplacian.Laplacian",
                f"a roof {offset:g} sizes from the origin",
                "what it is at the origin",
                lambda p=positions: _laplacian(p),
                lambda p=positions: _plain_laplacian(p),
                truth,
                tolerance=1e-5,
                formula="Σ |L x|² in float32",
            )
        )
    needle = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 1e-9, 0], [0.5, 1, 0]])
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 0, 0], [0.5, 1, 0]])
    faces = np.array([[0, 1, 2], [1, 0, 3]])
    for name, positions in (("a needle of height 1e-9", needle), ("a triangle without area", flat)):
        cases.append(
            Case(
                "geometry",
                "hir_plugins.regularizers.laplacian.mesh_laplacian",
                f"cotangents of {name}",
                "rows of shares, at most 1",
                lambda p=positions: float(
                    mesh_laplacian(_mesh(p, faces), cotangent=True)[0].to_dense().abs().max() <= 1.000001
                ),
                lambda p=positions: float(
                    np.isfinite(_plain_cotangents(p, faces)).all() and np.abs(_plain_cotangents(p, faces)).max() < 1e3
                ),
                1.0,
                formula="cot θ = cos θ / sin θ",
            )
        )
    lonely = np.vstack([_ROOF, [[9.0, 9, 9]]])
    cases.append(
        Case(
            "geometry",
            "hir_plugins.regularizers.laplacian.mesh_laplacian",
            "a vertex without neighbours",
            "a row of zeros",
            lambda: mesh_laplacian(_mesh(lonely))[0].to_dense()[4].abs().sum(),
            lambda: np.float32(0) / np.float32(0),
            0.0,
            formula="Σ neighbours / count − x",
        )
    )
    for scale in (1e-20, 1e20):
        cases.append(
            Case(
                "geometry",
                "hir_plugins.regularizers.laplacian.mesh_laplacian",
                f"`scale_free` weights at size {scale:g}",
                "0 weights that are not finite",
                lambda s=scale: float((~torch.isfinite(mesh_laplacian(_mesh(_ROOF * s), scale_free=True)[1])).sum()),
                lambda s=scale: (
                    float((~np.isfinite(12 / (np.float32(s) * np.float32(s)))).sum())
                    if s < 1
                    else float(np.isinf(np.float32(s) * np.float32(s) * np.float32(12)))
                ),
                0.0,
                formula="12 / area in float32",
            )
        )
    cases.append(
        Case(
            "geometry",
            "hir_plugins.regularizers.edge_length.EdgeLength",
            "gradient with all vertices at one point",
            "0 values that are not finite",
            lambda: _bad_gradients(lambda m: EdgeLength(EdgeLengthOptions()).prepare(Scene(m))(Scene(m)), _ROOF * 0),
            lambda: _bad_gradients(
                lambda m: (
                    (m.positions[m.topology.edges[:, 0]] - m.positions[m.topology.edges[:, 1]]).square().sum().sqrt()
                ),
                _ROOF * 0,
            ),
            0.0,
            formula="√Σe², differentiated",
        )
    )
    return cases


def _laplacian(positions: np.ndarray) -> torch.Tensor:
    scene = Scene(_mesh(positions))
    return Laplacian(LaplacianOptions()).prepare(scene)(scene)


def _plain_laplacian(positions: np.ndarray) -> torch.Tensor:
    mesh = _mesh(positions)
    return (mesh_laplacian(mesh)[0] @ mesh.positions).square().sum()


def _plain_cotangents(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    p = positions.astype(np.float32)[faces]
    u, v = p[:, 1] - p[:, 2], p[:, 0] - p[:, 2]
    return np.asarray((u * v).sum(1) / np.linalg.norm(np.cross(u, v), axis=1))


CASES = [*_normals(), *_smoothness()]
