"""The silhouette of a mesh, against many rays through every pixel."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from hir_core.capture import Camera, Capture, Pixels, View
from hir_core.errors import StageError
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.plugins import NoOptions
from hir_core.scene import Mesh, Scene, Topology
from hir_plugins.masks.mesh_silhouette import MeshSilhouette
from tests.fixtures.scenes import looking_at

SIDE = 24
"""Rays along each side of a pixel."""


def torn() -> trimesh.Trimesh:
    """A ball with noise and a quarter of its faces missing: many outlines, and edges with one face."""
    mesh = trimesh.creation.icosphere(subdivisions=3)
    rng = np.random.default_rng(0)
    mesh.vertices += 0.05 * rng.standard_normal(mesh.vertices.shape)
    return trimesh.Trimesh(mesh.vertices, mesh.faces[rng.random(len(mesh.faces)) > 0.25], process=False)


def doubled() -> trimesh.Trimesh:
    """Edges with three faces, and a triangle without area."""
    mesh = trimesh.creation.box(extents=(1, 1.2, 0.8))
    fin = [[0, 1, 6], [0, 0, 3]]
    return trimesh.Trimesh(mesh.vertices, np.concatenate([mesh.faces, fin]), process=False)


MESHES = {
    "ball": trimesh.creation.icosphere(subdivisions=2),
    "ring": trimesh.creation.torus(0.8, 0.25),
    "thin": trimesh.creation.cylinder(0.004, 2.0, sections=5),
    "torn": torn(),
    "doubled": doubled(),
}
EYES = ((3.0, 0.4, 0.2), (0.1, 2.8, 0.9), (-1.5, -1.2, 2.0))


def mask_of(mesh: trimesh.Trimesh, camera: Camera) -> np.ndarray:
    positions, faces = torch.from_numpy(mesh.vertices.astype(np.float32)), torch.from_numpy(np.array(mesh.faces))
    empty = Pixels(np.zeros((1, 1, 3), np.float32), None, np.zeros((1, 1), bool))
    capture = Capture(Path("made"), (View("a", camera, lambda: empty), View("b", None, lambda: empty)))
    found, none = MeshSilhouette(NoOptions()).masks(capture, Scene(Mesh(positions, Topology(faces))))
    assert found is not None and none is None
    return found


def all_rays(mesh: trimesh.Trimesh, camera: Camera) -> np.ndarray:
    positions = mesh.vertices.astype(np.float32).astype(np.float64)
    center = positions.mean(axis=0)
    steps = (np.arange(camera.width * SIDE) + 0.5) / SIDE
    rows = (np.arange(camera.height * SIDE) + 0.5) / SIDE
    origins, directions = camera.rays(np.stack(np.meshgrid(steps, rows), axis=-1).reshape(-1, 2))
    hit = MeshQueries(positions - center, np.array(mesh.faces)).occluded(origins - center, directions)
    blocks = hit.reshape(camera.height, SIDE, camera.width, SIDE)
    return np.asarray(blocks.mean(axis=(1, 3), dtype=np.float64))


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("eye", EYES)
def test_masks_are_those_of_many_rays(name: str, eye: tuple[float, float, float]) -> None:
    camera = looking_at(eye, 80, 64)
    found, expected = mask_of(MESHES[name], camera), all_rays(MESHES[name], camera)
    assert 0 < expected.mean() < 1
    # an edge along a row of rays is wrong by one row of them, 0.04
    np.testing.assert_allclose(found, expected, atol=0.06)
    edge = (expected > 0) & (expected < 1)
    assert np.abs(found - expected)[edge].mean() < 0.02


def test_a_mesh_around_the_camera_is_cut_at_the_image_plane() -> None:
    """A ball that the camera is in covers all pixels, though half of it is behind the camera."""
    assert (mask_of(MESHES["ball"], looking_at((0.5, 0.1, 0.0), 40, 30)) == 1).all()


def test_an_object_outside_the_image_has_an_empty_mask() -> None:
    camera = looking_at(EYES[0], 40, 30)
    shifted = camera.intrinsics + np.array([[0, 0, 500.0], [0, 0, 0], [0, 0, 0]])
    assert not mask_of(MESHES["ball"], replace(camera, intrinsics=shifted)).any()


def test_a_missing_mesh_is_named() -> None:
    with pytest.raises(StageError, match="mesh_file"):
        MeshSilhouette(NoOptions()).masks(Capture(Path("made"), ()), None)
