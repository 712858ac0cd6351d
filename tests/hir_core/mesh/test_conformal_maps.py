"""Conformal maps of charts with a known answer, and maps that overlap."""

from __future__ import annotations

import numpy as np
import pytest

from hir_core.mesh.conformal_maps import conformal_map, is_injective, signed_areas, stretch


def grid(rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Parameters (V, 2) in 0…1 and faces (F, 3) of a grid."""
    y, x = np.mgrid[0 : rows + 1, 0 : columns + 1]
    corner = (y * (columns + 1) + x)[:-1, :-1].reshape(-1)
    lower = np.stack([corner, corner + 1, corner + columns + 1], axis=1)
    upper = np.stack([corner + 1, corner + columns + 2, corner + columns + 1], axis=1)
    return np.stack([x / columns, y / rows], axis=-1).reshape(-1, 2), np.concatenate([lower, upper])


def test_a_curved_sheet_is_unrolled_with_its_lengths() -> None:
    """A part of a cylinder of many facets has a map without stretch: every edge keeps its length."""
    st, faces = grid(24, 40)
    angle = 2.5 * st[:, 0]
    positions = np.stack([np.cos(angle), np.sin(angle), 1.7 * st[:, 1]], axis=1)
    uvs = conformal_map(positions, faces)
    assert is_injective(uvs, faces)
    assert stretch(positions, faces, uvs) == pytest.approx(1, abs=2e-4)
    for k in range(3):
        i, j = faces[:, k], faces[:, (k + 1) % 3]
        true = np.linalg.norm(positions[i] - positions[j], axis=1)
        np.testing.assert_allclose(np.linalg.norm(uvs[i] - uvs[j], axis=1), true, rtol=2e-3)


def test_a_map_of_a_cap_is_conformal() -> None:
    """A cap of a sphere: the right angles of the grid stay right within 2°, the area is kept in all."""
    st, faces = grid(30, 30)
    x, y = (st - 0.5).T
    positions = np.stack([x, y, np.sqrt(1 - x**2 - y**2)], axis=1)
    uvs = conformal_map(positions, faces)
    p, q = positions[faces], uvs[faces]

    def angles(corners: np.ndarray) -> np.ndarray:
        first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        size = np.linalg.norm(first, axis=1) * np.linalg.norm(second, axis=1)
        return np.degrees(np.arccos((first * second).sum(axis=1) / size))

    assert np.abs(angles(p) - angles(q)).max() < 2
    surface = 0.5 * np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1).sum()
    assert abs(signed_areas(uvs, faces).sum()) == pytest.approx(surface, rel=1e-9)
    assert 1 < stretch(positions, faces, uvs) < 1.05


def test_a_surface_without_boundary_has_no_map() -> None:
    faces = np.array([[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]])
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    uvs = conformal_map(positions, faces)
    assert np.isnan(uvs).all() and not is_injective(uvs, faces)


def test_overlaps_of_two_kinds_are_found() -> None:
    """A strip that goes round more than once has no flipped triangle but a boundary that crosses itself; a folded
    triangle is flipped.
    """
    st, faces = grid(2, 60)
    angle, radius = 1.2 * 2 * np.pi * st[:, 0], 1 + 0.2 * st[:, 1]
    around = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    areas = signed_areas(around, faces)
    assert (areas > 0).all() or (areas < 0).all()
    assert not is_injective(around, faces)
    less = np.stack([radius * np.cos(0.8 * angle), radius * np.sin(0.8 * angle)], axis=1)
    assert is_injective(less, faces)
    folded = st.copy()
    folded[70] += [0.0, 0.9]
    assert is_injective(st, faces) and not is_injective(folded, faces)


def test_stretch_of_a_scaled_axis_is_known() -> None:
    """A map that doubles one axis: scaled to the area, the singular values are √2 and 1/√2, so L² = √(5/4)."""
    st, faces = grid(4, 4)
    positions = np.concatenate([st, np.zeros((len(st), 1))], axis=1)
    assert stretch(positions, faces, st * [2, 1]) == pytest.approx(np.sqrt(1.25))
    assert stretch(positions, faces, st * [3, 0]) == np.inf
