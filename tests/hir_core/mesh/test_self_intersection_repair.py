"""Repair of self-intersections: what moves, what stays, and that only patches are searched again."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from hir_core.mesh.mesh_validity import inspect_mesh, self_intersections
from hir_core.mesh.self_intersection_repair import (
    Connectivity,
    IntersectingSurface,
    _faces_near,
    separate_sheets,
    smooth_intersections,
)
from tests.fixtures.meshes import icosphere


def test_repair_moves_back_to_an_earlier_state_where_the_surface_folded() -> None:
    before, faces = icosphere(4)
    generator = np.random.default_rng(0)
    # a bump all over, which is right, and three patches turned inside out, which are not
    bumped = before * (1 + 0.02 * np.cos(7 * before[:, :1]))
    folded = bumped.copy()
    for centre in generator.normal(size=(3, 3)):
        patch = before @ (centre / np.linalg.norm(centre)) > 0.97
        folded[patch] += generator.normal(scale=0.08, size=(int(patch.sum()), 3))
    assert inspect_mesh(folded, faces).self_intersecting > 20
    repaired = smooth_intersections(IntersectingSurface.of(folded, faces), 0, toward=before).positions
    assert inspect_mesh(repaired, faces).self_intersecting == 0
    moved = np.linalg.norm(repaired - folded, axis=1) > 0
    assert 0.02 < moved.mean() < 0.3
    # each vertex lies between where it was then and where it had gone
    back, away = (np.linalg.norm(state[moved] - before[moved], axis=1) for state in (repaired, folded))
    assert (back < away).all()


def test_grazing_sheets_are_separated() -> None:
    lower, faces = icosphere(4)
    upper = lower + np.array([0.0, 1.999, 0.0])
    positions, both = np.concatenate([lower, upper]), np.concatenate([faces, faces + len(lower)])
    assert inspect_mesh(positions, both).self_intersecting > 0
    repaired = separate_sheets(IntersectingSurface.of(positions, both), 0).positions
    assert inspect_mesh(repaired, both).self_intersecting == 0
    edge = np.linalg.norm(lower[faces[:, 0]] - lower[faces[:, 1]], axis=1).mean()
    moved = np.linalg.norm(repaired - positions, axis=1)
    assert moved.max() < edge
    assert (moved > 0).mean() < 0.05
    # each sphere gives way to its own side
    assert (repaired[: len(lower), 1] <= lower[:, 1] + 1e-12).all()
    assert (repaired[len(lower) :, 1] >= upper[:, 1] - 1e-12).all()


def test_repair_removes_a_spike_and_leaves_the_rest() -> None:
    positions, faces = icosphere(3)
    spoilt = positions.copy()
    spoilt[5] *= -1.4
    assert inspect_mesh(spoilt, faces).self_intersecting > 0
    repaired = smooth_intersections(IntersectingSurface.of(spoilt, faces), 0).positions
    assert inspect_mesh(repaired, faces).self_intersecting == 0
    # the spike pierced the far side too
    far = np.abs(positions @ positions[5]) < 0.3
    assert np.array_equal(repaired[far], positions[far])


def test_faces_near_moved_vertices_are_all_that_are_near_enough() -> None:
    positions, faces = icosphere(3)
    far = positions * 0.01 + np.array([0.0, 0.0, 30.0])  # a small part far away makes the grid large
    both, parts = np.concatenate([faces, faces + len(positions)]), np.concatenate([positions, far])
    for rows in (np.array([7]), np.array([3, 200, len(positions) + 4])):
        own = np.flatnonzero(np.isin(both, rows).any(axis=1))
        corners = parts[both[own]]
        longest = max(np.linalg.norm(corners[:, i] - corners[:, i - 1], axis=1).max() for i in range(3))
        centroids = parts[both].mean(axis=1)
        distance, _ = cKDTree(centroids[own]).query(centroids)
        found = _faces_near(parts, Connectivity(both, len(parts)), rows)
        np.testing.assert_array_equal(found, np.union1d(own, np.flatnonzero(distance < 3 * longest)))
        assert len(own) < len(found) < 0.6 * len(both)


def test_the_mean_of_neighbours_counts_an_edge_for_each_of_its_faces() -> None:
    values = np.arange(12.0).reshape(4, 3)
    connectivity = Connectivity(np.array([[0, 1, 2], [0, 2, 3]]), 5)
    found = connectivity.mean_of_neighbours(np.concatenate([values, np.zeros((1, 3))]), np.array([0, 1, 4]))
    np.testing.assert_allclose(
        found, [(values[1] + 2 * values[2] + values[3]) / 4, (values[0] + values[2]) / 2, 0 * values[0]]
    )
    assert connectivity.grown(np.array([1]), 1).tolist() == [0, 1, 2]
    assert connectivity.grown(np.array([1]), 2).tolist() == [0, 1, 2, 3]


def test_triangles_that_intersect_after_a_move_are_those_of_a_search_of_all() -> None:
    positions, faces = icosphere(4)
    surface, generator = IntersectingSurface.of(positions, faces), np.random.default_rng(1)
    assert not len(surface.hit)
    for _ in range(3):
        centre = generator.normal(size=3)
        rows = np.flatnonzero(positions @ centre > 0.95 * np.linalg.norm(centre))
        moved = surface.positions.copy()
        moved[rows] += generator.normal(scale=0.05, size=(len(rows), 3))
        surface = surface.moved(moved, rows)
        np.testing.assert_array_equal(np.sort(surface.hit), self_intersections(moved, faces))
    assert len(surface.hit) > 20
