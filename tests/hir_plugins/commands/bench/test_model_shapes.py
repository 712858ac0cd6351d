"""Model files as shapes of larger captures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from benchmarks.materials.model_shapes import MEAN_EDGE, shape_of_model


def two_balls() -> trimesh.Trimesh:
    """A large ball at the origin and a small one above it along +Y."""
    large, small = trimesh.creation.icosphere(2, radius=1.0), trimesh.creation.icosphere(1, radius=0.3)
    small.apply_translation([0, 2, 0])
    return trimesh.util.concatenate([small, large])


@pytest.mark.parametrize(("suffix", "up"), [(".ply", 1), (".glb", 2)])
def test_a_model_is_scaled_divided_into_parts_and_turned_upright(tmp_path: Path, suffix: str, up: int) -> None:
    path = tmp_path / f"balls{suffix}"
    two_balls().export(path)
    shape = shape_of_model(path)
    assert np.linalg.norm(shape.positions, axis=1).max() == pytest.approx(0.95, abs=1e-5)
    assert np.abs(np.linalg.norm(shape.normals, axis=1) - 1).max() < 1e-5
    assert set(shape.parts) == {0, 1} and (shape.parts == 0).sum() > (shape.parts == 1).sum()
    assert shape.positions[shape.parts == 1, up].min() > shape.positions[shape.parts == 0, up].max()
    a, b, c = (shape.positions[shape.faces[:, i]] for i in range(3))
    outward = np.cross(b - a, c - a)
    assert (np.einsum("ij,ij->i", outward, shape.normals[shape.faces[:, 0]]) > 0).all()
    edges = np.linalg.norm(np.concatenate([a - b, b - c, c - a]), axis=1)
    assert edges.mean() <= MEAN_EDGE


def test_copies_of_a_vertex_at_a_texture_seam_are_one_vertex(tmp_path: Path) -> None:
    ball = two_balls()
    corners = np.arange(3 * len(ball.faces)).reshape(-1, 3)
    split = trimesh.Trimesh(ball.vertices[ball.faces.reshape(-1)], corners, process=False)
    split.export(tmp_path / "split.ply")
    ball.export(tmp_path / "joined.ply")
    split_shape, joined = (shape_of_model(tmp_path / f"{name}.ply") for name in ("split", "joined"))
    assert len(split_shape.positions) == len(joined.positions) and set(split_shape.parts) == {0, 1}
