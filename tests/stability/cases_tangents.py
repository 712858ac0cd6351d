"""Tangents of triangles without area in the world or in the texture, vertices that differ by the sign of a zero."""

from __future__ import annotations

import numpy as np
from hir_exporters.mesh.tangents import corner_tangents
from hir_exporters.mesh.vertex_welding import weld

from hir_core.mesh.mesh_validity import inspect_mesh
from tests.stability.case import Case


def _textures() -> list[Case]:
    positions = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    normals = np.tile(np.array([0, 0, 1], np.float32), (3, 1))
    faces = np.array([[0, 1, 2]], np.int32)
    uv = np.array([[0.1, 0.9], [0.9, 0.9], [0.1, 0.1]], np.float32)
    cases = []
    for name, p, t in (
        ("without area in the texture", positions, uv * 0),
        ("all UVs on a line", positions, uv * [1, 0]),
        ("of size 1e-23 in the texture", positions, uv * 1e-23),
        ("of size 1e25 in the world", positions * 1e25, uv),
    ):
        cases.append(
            Case(
                "export",
                "hir_exporters.mesh.tangents.corner_tangents",
                f"a triangle {name}",
                "unit tangents",
                lambda p=p, t=t: np.linalg.norm(
                    corner_tangents(p.astype(np.float32), normals, t.astype(np.float32), faces)[0, :, :3], axis=1
                ),
                lambda p=p, t=t: _plain_tangent(p.astype(np.float32), t.astype(np.float32)),
                lambda: np.ones(3),
                tolerance=1e-6,
                formula="t = (e₁ Δv₂ − e₂ Δv₁) / det, over √(t·t), float32",
            )
        )
    signs = np.array([[0.0, 1.0], [-0.0, 1.0]], np.float32)
    cases.append(
        Case(
            "export",
            "hir_exporters.mesh.vertex_welding.weld",
            "two vertices, one with −0 instead of 0",
            "one vertex",
            lambda: len(weld(signs)[0]),
            lambda: len({row.tobytes() for row in signs}),
            1.0,
            formula="a set of the bytes",
        )
    )
    folded = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1e-12, 0]])
    cases.append(
        Case(
            "geometry",
            "hir_core.mesh.mesh_validity.inspect_mesh",
            "a triangle of size 1e-12 among others",
            "counted, nothing NaN",
            lambda: inspect_mesh(folded, np.array([[0, 1, 2], [0, 3, 0]])).degenerate,
            lambda: np.float64(np.isfinite(np.zeros(3) / np.linalg.norm(np.zeros(3))).all()),
            1.0,
            formula="n / |n|",
        )
    )
    return cases


def _plain_tangent(p: np.ndarray, t: np.ndarray) -> np.ndarray:
    e1, e2, d1, d2 = p[1] - p[0], p[2] - p[0], t[1] - t[0], t[2] - t[0]
    tangent = (e1 * d2[1] - e2 * d1[1]) / (d1[0] * d2[1] - d1[1] * d2[0])
    return np.tile(np.linalg.norm(tangent / np.sqrt((tangent * tangent).sum())), 3)


CASES = _textures()
