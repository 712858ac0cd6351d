"""Measured depths in the geometry fit: distances, gradients, weights, and what they hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from hir_core.capture import Camera, Capture, DepthPixels, MeasuredDepth, View
from hir_core.config import GeometrySettings
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.plugins.manager import PluginManager
from hir_core.run.stage_context import StageContext
from hir_core.scene import Mesh, Scene, Topology
from hir_core.stages.geometry.geometry_fit import fit_geometry
from hir_core.stages.geometry.measured_depths import depth_term
from hir_core.stages.geometry.measured_depths.depth_term import DepthRays, depth_rays
from hir_core.testing.captures import StoredPixels
from tests.fixtures.made_captures import around, bowl
from tests.fixtures.scenes import looking_at

SIZE = 96


def square(height: float = 0.0) -> Mesh:
    """The square −1…1 at this z, of 200 triangles."""
    axis = np.linspace(-1, 1, 11)
    x, y = np.meshgrid(axis, axis)
    corner = np.arange(121).reshape(11, 11)
    a, b, c, d = (corner[i : i + 10, j : j + 10].ravel() for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)))
    faces = np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])
    points = np.stack([x.ravel(), y.ravel(), np.full(121, height)], axis=1).astype(np.float32)
    return Mesh(torch.from_numpy(points), Topology(torch.from_numpy(faces)))


def rays_to(height: float, count: int = 50, weight: float = 1.0) -> DepthRays:
    """Slanted rays from above that ended at this z."""
    random = np.random.default_rng(0)
    end = np.concatenate([random.uniform(-0.6, 0.6, (count, 2)), np.full((count, 1), height)], axis=1)
    start = np.array([0.1, 0.2, 5.0])
    along = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    arrays = (np.broadcast_to(start, end.shape), along, end, np.full(count, weight))
    return DepthRays(*(np.asarray(a, np.float32) for a in arrays), 0.05)


def test_distances_are_along_the_normal() -> None:
    assert rays_to(0.01).median_distance(square()) == pytest.approx(0.01, rel=1e-4)
    assert float(rays_to(0.01).energy(square(), 0)) == pytest.approx(1e-4 * 0.0025 / 0.0026, rel=1e-3)
    assert float(rays_to(0.01, weight=0.5).energy(square(), 0)) == pytest.approx(0.5e-4 * 0.0025 / 0.0026, rel=1e-3)
    assert float(rays_to(3.0).energy(square(), 0)) < 0.05**2, "an outlier costs no more than this"


def test_the_gradient_moves_the_surface_to_the_points() -> None:
    """Against finite differences, in float64, of a surface that moves as a whole; normals do not change then."""
    mesh, rays = square(), rays_to(0.01)
    height = torch.zeros((), dtype=torch.float64, requires_grad=True)

    def energy(z: torch.Tensor) -> torch.Tensor:
        return rays.energy(mesh.with_positions(mesh.positions.double() + torch.stack([0 * z, 0 * z, z])), 0)

    energy(height).backward()
    step = 1e-4
    with torch.no_grad():
        expected = (energy(height + step) - energy(height - step)) / (2 * step)
    assert height.grad is not None and float(height.grad) == pytest.approx(float(expected), rel=1e-3)
    assert float(height.grad) < 0


def test_every_ray_has_its_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    """The batch is that of the step alone, so an interrupted fit goes on with the same ones."""
    monkeypatch.setattr(depth_term, "RAYS_PER_STEP", 10)
    rays, seen = rays_to(0.0, 53), []

    def cast(self: MeshQueries, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        seen.append(directions)
        return np.full(len(origins), -1), np.zeros((len(origins), 3), np.float32)

    monkeypatch.setattr(MeshQueries, "first_hits", cast)
    for step in range(5):
        assert float(rays.energy(square(), step)) == 0
    assert sorted(map(tuple, np.concatenate(seen))) == sorted(map(tuple, rays.directions))


def true_depth(camera: Camera, mesh: Mesh) -> np.ndarray:
    """Depth (H, W) along the optical axis, 0 beside the object."""
    positions, faces = mesh.positions.numpy().astype(np.float64), mesh.faces.numpy()
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    face, weights = MeshQueries(positions, faces).first_hits(*camera.rays(pixels))
    points = (positions[faces[np.maximum(face, 0)]] * weights[..., None]).sum(axis=1)
    return np.where(face >= 0, camera.project(points)[1], 0).reshape(camera.height, camera.width)


def views_of(mesh: Mesh, count: int, confidence: float = 1.0) -> tuple[View, ...]:
    found = []
    for number, eye in enumerate(around(count, 0.9)):
        camera = looking_at(eye, SIZE, SIZE)
        depth = true_depth(camera, mesh).astype(np.float32)
        mask = (depth > 0).astype(np.float32)
        pixels = DepthPixels(depth, mask * np.float32(confidence))
        color = np.full((SIZE, SIZE, 3), 0.5, np.float32) * mask[..., None]
        measured = MeasuredDepth(lambda found=pixels: found)  # type: ignore[misc]
        found.append(View(str(number), camera, StoredPixels(color, mask), depth=measured))
    return tuple(found)


def test_rays_end_on_the_surface_that_was_measured() -> None:
    mesh = bowl()
    views = views_of(mesh, 4, confidence=0.5)
    rays = depth_rays(views, 1.0, seed=0)
    assert rays is not None
    distance, _ = MeshQueries(mesh.positions.numpy(), mesh.faces.numpy()).nearest(rays.points)
    assert distance.max() < 1e-4 and len(distance) > 2000
    assert rays.median_distance(mesh) < 1e-4
    assert (rays.weights == 0.5).all()
    without = (*views, *(View(v.name, v.camera, v.read) for v in views))
    half = depth_rays(without, 1.0, seed=0)
    assert half is not None and (half.weights == 0.25).all(), "a part of the views counts as a part"
    assert depth_rays(views_of(mesh, 2, confidence=0.2), 1.0, seed=0) is None, "as those of low confidence"


@pytest.mark.slow
def test_depths_hold_what_no_outline_shows(tmp_path: Path) -> None:
    """The inside of a bowl, from a first mesh that is right: without depths the stage smooths it."""
    true = bowl()
    fine = trimesh.Trimesh(true.positions.numpy(), true.faces.numpy(), process=False).subdivide().subdivide()
    start = Scene(Mesh(torch.tensor(fine.vertices, dtype=torch.float32), Topology(torch.tensor(fine.faces).long())))
    capture = Capture(Path("bowl"), views_of(true, 12))
    inside = trimesh.Trimesh(true.positions.numpy(), true.faces.numpy(), process=False).sample(20_000, seed=0)
    inside = inside[np.linalg.norm(inside, axis=1) < 0.9]

    def error(weight: float) -> float:
        terms = {"laplacian": {"weight": 1e-5, "cotangent": True, "scale_free": True}}
        settings = GeometrySettings(
            renderer="contour", regularizers=terms, photo_consistency="off", depth_weight=weight, iterations=150
        )
        folder = tmp_path / str(weight)
        folder.mkdir()
        fitted, report = fit_geometry(start, capture, settings, StageContext(PluginManager.discover(), folder))
        assert (report.sensor_depth is None) == (weight == 0)
        if report.sensor_depth is not None:
            assert report.sensor_depth.rays > 10_000
        mesh = fitted.scene.mesh
        return float(MeshQueries(mesh.positions.numpy(), mesh.faces.numpy()).nearest(inside)[0].mean())

    held, smoothed = error(30.0), error(0.0)
    assert held < 0.6 * smoothed
