"""Borders of surfaces whose vertices are not shared, whose seams are rounded, and that have holes."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hir_exporters.mesh.open_surface import is_open

SPHERE = trimesh.creation.icosphere(subdivisions=3)
CORNERS = np.asarray(SPHERE.triangles, np.float32).reshape(-1, 3)
FACES = np.arange(len(CORNERS)).reshape(-1, 3)


@pytest.mark.parametrize("noise", [0.0, 1e-7])
def test_a_closed_surface_without_shared_vertices(noise: float) -> None:
    rounding = np.random.default_rng(0).normal(0, noise, CORNERS.shape).astype(np.float32)
    assert not is_open(CORNERS + rounding, FACES)


def test_a_surface_without_some_triangles_is_open() -> None:
    assert is_open(CORNERS, FACES[CORNERS[FACES].mean(axis=1)[:, 2] < 0.5])
    assert is_open(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32), np.array([[0, 1, 2]]))


def test_a_point_has_no_border() -> None:
    assert not is_open(np.zeros((3, 3), np.float32), np.array([[0, 1, 2]]))
