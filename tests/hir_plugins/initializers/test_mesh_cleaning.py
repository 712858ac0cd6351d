"""First meshes become manifold, whole and even; depth maps alone make a surface."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

from hir_core.errors import StageError
from hir_core.mesh.mesh_validity import self_intersections
from hir_plugins.initializers.stereo.depth_consistency import DepthMap
from hir_plugins.initializers.stereo.tsdf import tsdf_surface
from hir_plugins.initializers.surface.mesh_cleaning import clean_mesh, edge_length, pixel_size
from tests.fixtures.silhouette_captures import hits_sphere, look_at, shape_capture


def test_a_fin_and_a_crumb_are_cleaned_off_and_the_surface_stays() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    crumb = trimesh.creation.icosphere(subdivisions=0, radius=0.01).apply_translation([2, 0, 0])
    # a third triangle on an edge of the ball, smaller than the two that belong there
    tip = ball.vertices[ball.faces[0, :2]].mean(axis=0) * 1.01
    positions = np.concatenate([ball.vertices, crumb.vertices, [tip]])
    fin = np.array([[*ball.faces[0, :2], len(positions) - 1]])
    faces = np.concatenate([ball.faces, crumb.faces + len(ball.vertices), fin])
    x, f = clean_mesh(positions, faces, 0.1, 0.02)
    result = trimesh.Trimesh(x, f, process=False)
    assert result.is_winding_consistent and result.body_count == 1
    radii = np.linalg.norm(x, axis=1)
    assert radii.min() > 0.98 and radii.max() < 1.001
    lengths = result.edges_unique_length
    assert abs(lengths.mean() / 0.1 - 1) < 0.15 and lengths.max() < 0.2
    assert len(self_intersections(x, f)) == 0


def test_nothing_but_a_line_is_refused() -> None:
    with pytest.raises(StageError, match="no triangles"):
        clean_mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]), 0.1, 0.02)


def test_edges_are_as_long_as_the_pixels_say() -> None:
    cameras = [look_at(2.0 * np.array([np.sin(t), 0, np.cos(t)]), np.zeros(3), 400.0, 64, 64) for t in (0.0, 1.0, 2.0)]
    corners = np.array([[-0.1, -0.1, -0.1], [0.1, 0.1, 0.1]])
    assert pixel_size(cameras, np.zeros(3)) == pytest.approx(2.0 / 400)
    capture = shape_capture(cameras, hits_sphere(np.zeros(3), 0.1))
    assert edge_length(capture, corners, 2.5) == pytest.approx(2.5 * 2 / 400)
    # voxels of this size tell no more
    assert edge_length(capture, corners, 2.5, spacing=0.04) == pytest.approx(0.05)
    assert edge_length(capture, corners, 0.0, spacing=0.04) == 0


@pytest.mark.parametrize("scale,place", [(1.0, 0.0), (1e-3, 5.0), (1000.0, 0.0)])
def test_depth_maps_of_a_ball_make_a_ball(scale: float, place: float) -> None:
    maps = []
    for direction in trimesh.creation.icosphere(subdivisions=1).vertices:
        camera = look_at(place + 3 * scale * direction, np.full(3, place), 60.0, 64, 64)
        rows, columns = np.mgrid[0:64, 0:64] + 0.5
        origin, rays = camera.rays(np.stack([columns, rows], axis=-1).reshape(-1, 2))
        offset = (origin - place) / scale
        b, c = (offset * rays).sum(axis=1), (offset**2).sum(axis=1) - 1
        distance = -b - np.sqrt(np.maximum(b * b - c, 0))
        depth = np.where(b * b > c, distance * (rays @ camera.world_to_camera[2, :3]) * scale, np.inf)
        inverse = torch.from_numpy((1 / depth).reshape(64, 64).astype(np.float32))
        maps.append(DepthMap(camera, inverse, (inverse > 0).float()))
    x, f = tsdf_surface(maps, 0.05 * scale)
    radii = np.linalg.norm(x - place, axis=1) / scale
    assert np.abs(radii - 1).max() < 0.05 and abs(radii.mean() - 1) < 0.01
    assert trimesh.Trimesh(x, f).volume == pytest.approx(4 / 3 * np.pi * scale**3, rel=0.03)


def test_maps_without_depth_make_no_surface() -> None:
    camera = look_at(np.array([0, 0, 3.0]), np.zeros(3), 60.0, 8, 8)
    with pytest.raises(StageError, match="give no surface"):
        tsdf_surface([DepthMap(camera, torch.zeros(8, 8), torch.zeros(8, 8))], 0.1)
