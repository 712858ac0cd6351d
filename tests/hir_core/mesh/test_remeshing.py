"""Remeshing keeps surface and topology and makes even triangles; the mesh checks count what they say."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest
import torch

from hir_core.mesh.attribute_transfer import remeshed
from hir_core.mesh.mesh_validity import _candidates, inspect_mesh, self_intersections
from hir_core.mesh.remeshing import mean_edge_length, remesh, surface_area
from hir_core.scene import Mesh, Topology
from tests.fixtures.meshes import bumpy_sphere, icosphere, torus

pytest.importorskip("open3d")


def _quality(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """1 for equilateral triangles, 0 for needles."""
    p = positions[faces]
    area = 0.5 * np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    return 4 * np.sqrt(3) * area / ((p - np.roll(p, 1, axis=1)) ** 2).sum(axis=(1, 2))


@pytest.mark.parametrize("factor", [0.5, 2.5])
@pytest.mark.parametrize("make", [lambda: bumpy_sphere(4), lambda: torus(96, 48)], ids=["bumpy", "torus"])
def test_surface_and_topology_stay(make, factor: float) -> None:
    positions, faces = make()
    length = factor * mean_edge_length(positions, faces)
    x, f = remesh(positions, faces, length)
    before, after = inspect_mesh(positions, faces), inspect_mesh(x, f)
    assert after.watertight and after.genus == before.genus and after.components == 1
    assert after.degenerate == after.folded == after.self_intersecting == 0
    assert mean_edge_length(x, f) == pytest.approx(length, rel=0.15)
    # as even as before, and without needles
    assert _quality(x, f).mean() > min(0.95, _quality(positions, faces).mean())
    assert np.quantile(_quality(x, f), 0.01) > 0.5
    # the volume within one chord's error
    volumes = [
        np.einsum("ij,ij->", p[g][:, 0], np.cross(p[g][:, 1], p[g][:, 2])) / 6 for p, g in ((positions, faces), (x, f))
    ]
    assert volumes[1] == pytest.approx(volumes[0], rel=0.05 if factor > 1 else 0.005)


def test_needles_become_triangles() -> None:
    positions, faces = icosphere(3)
    stretched = positions * [1.0, 1.0, 12.0]
    x, f = remesh(stretched, faces, 0.25, rounds=6)
    assert np.quantile(_quality(x, f), 0.01) > 0.5
    assert inspect_mesh(x, f).watertight


def test_rims_stay_where_they_are() -> None:
    grid = np.stack(np.meshgrid(np.arange(9.0), np.arange(9.0), indexing="ij"), -1).reshape(-1, 2)
    positions = np.concatenate([grid, np.zeros((81, 1))], axis=1)
    a = (np.arange(8)[:, None] * 9 + np.arange(8)).reshape(-1)
    faces = np.concatenate([np.stack([a, a + 9, a + 10], 1), np.stack([a, a + 10, a + 1], 1)])
    x, f = remesh(positions, faces, 2.5)
    assert surface_area(x, f) == pytest.approx(64.0, rel=1e-9)
    rim = ((positions[:, :2] == 0) | (positions[:, :2] == 8)).any(axis=1)
    for corner in positions[rim]:
        assert np.abs(x - corner).max(axis=1).min() < 1e-6


@pytest.mark.parametrize(
    "mesh",
    [
        (np.zeros((0, 3)), np.zeros((0, 3), int)),
        (np.zeros((3, 3)), np.array([[0, 1, 2]])),
        (np.eye(3), np.array([[0, 0, 1]])),
        (np.full((3, 3), np.nan), np.array([[0, 1, 2]])),
        (np.concatenate([np.eye(3), [[3.0, 3, 3], [1, 3, 2]]]), np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])),
    ],
    ids=["empty", "a point", "an edge", "nan", "non-manifold"],
)
def test_broken_meshes_come_back(mesh: tuple[np.ndarray, np.ndarray]) -> None:
    x, f = remesh(*mesh, 0.3)
    assert x.shape[1] == f.shape[1] == 3 and (len(f) == 0 or f.max() < len(x))
    assert np.isfinite(x).all() == np.isfinite(mesh[0]).all()


def test_vertex_colors_come_along() -> None:
    positions, faces = icosphere(3)
    mesh = Mesh(
        torch.tensor(positions).float(), Topology(torch.tensor(faces)), vertex_colors=torch.tensor(positions).float()
    )
    finer = remeshed(mesh, 4000)
    assert abs(len(finer.faces) / 4000 - 1) < 0.25
    # a colour that is the position
    assert float((finer.vertex_colors - finer.positions).abs().max()) < 0.08


def test_counts_of_known_meshes() -> None:
    ball = icosphere(2)
    state = asdict(inspect_mesh(*ball))
    assert 5 < state.pop("largest_dihedral_deg") < 20 and 1 < state.pop("longest_edge_ratio") < 1.3
    assert state == {
        "vertices": 162,
        "triangles": 320,
        "components": 1,
        "watertight": True,
        "genus": 0,
        "degenerate": 0,
        "folded": 0,
        "self_intersecting": 0,
    }
    assert inspect_mesh(*torus()).genus == 1
    assert not inspect_mesh(ball[0], ball[1][1:]).watertight
    assert not inspect_mesh(ball[0], np.concatenate([ball[1][1:], ball[1][:1, ::-1]])).watertight
    two_balls = np.concatenate([ball[0], ball[0] + [3.0, 0, 0]]), np.concatenate([ball[1], ball[1] + 162])
    assert inspect_mesh(*two_balls).components == 2 and inspect_mesh(*two_balls).self_intersecting == 0
    assert inspect_mesh(np.zeros((0, 3)), np.zeros((0, 3), int)).triangles == 0


def test_a_spike_has_a_large_dihedral_and_a_long_edge() -> None:
    """A cube has right angles and diagonals of √2 edges; a vertex pulled far out is a spike of six sides, 60° apart."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))])
    cube = inspect_mesh(corners, faces)
    assert cube.watertight and cube.largest_dihedral_deg == pytest.approx(90)
    assert cube.longest_edge_ratio == pytest.approx(np.sqrt(2), abs=1e-3)
    ball = icosphere(2)
    pulled = ball[0].copy()
    pulled[40] *= 4
    spike = inspect_mesh(pulled, ball[1])
    assert spike.largest_dihedral_deg > 60 and spike.longest_edge_ratio > 9


def test_self_intersections_are_those_of_all_pairs() -> None:
    random = np.random.default_rng(0)
    positions = (random.uniform(size=(60, 1, 3)) + 0.25 * random.normal(size=(60, 3, 3))).reshape(-1, 3)
    faces = np.arange(180).reshape(-1, 3)
    p = positions[faces]
    hit = set()
    for i in range(60):
        for j in range(60):
            if i == j:
                continue
            for k in range(3):
                # the edge as a line meets the plane of the other triangle: solve for where
                a, d = p[i, k], p[i, (k + 1) % 3] - p[i, k]
                u, v = p[j, 1] - p[j, 0], p[j, 2] - p[j, 0]
                t, s, r = np.linalg.solve(np.stack([-d, u, v], axis=1), a - p[j, 0])
                if 0 < t < 1 and s > 0 and r > 0 and s + r < 1:
                    hit |= {i, j}
    assert len(hit) > 10
    assert set(self_intersections(positions, faces).tolist()) == hit


def _spikes(subdivisions: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """A sphere of which some vertices lie beyond the other side: few triangles as large as the mesh."""
    positions, faces = icosphere(subdivisions)
    positions = positions + 0.1 * 2.0**-subdivisions * np.random.default_rng(1).normal(size=positions.shape)
    positions[np.random.default_rng(0).choice(len(positions), count, replace=False)] *= -1.2
    return positions, faces


def test_self_intersections_of_triangles_of_any_size_are_those_of_open3d() -> None:
    open3d = pytest.importorskip("open3d")
    for positions, faces in (_spikes(3, 5), _spikes(3, 60)):
        mesh = open3d.geometry.TriangleMesh(
            open3d.utility.Vector3dVector(positions), open3d.utility.Vector3iVector(faces)
        )
        expected = set(np.asarray(mesh.get_self_intersecting_triangles()).ravel().tolist())
        assert len(expected) > 40
        assert set(self_intersections(positions, faces).tolist()) == expected


@pytest.mark.parametrize(("spikes", "pairs_per_triangle"), [(0, 40), (20, 300)])
def test_few_large_triangles_do_not_multiply_the_comparisons(spikes: int, pairs_per_triangle: int) -> None:
    """All pairs would be 5,120 for each triangle."""
    positions, faces = _spikes(4, spikes)
    p = positions[faces]
    compared = sum(len(first) for first, _ in _candidates(p.min(axis=1), p.max(axis=1), 400_000))
    assert compared < pairs_per_triangle * len(faces)
