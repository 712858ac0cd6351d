"""`sensor_depth`: cavities that no outline shows, from exact, noisy, coarse and partly wrong depths."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from hir_core.capture import Camera, Capture, DepthPixels, MeasuredDepth, View
from hir_core.capture.depth_samples import depth_noise
from hir_core.config import load_config
from hir_core.errors import CaptureError
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.plugins.manager import PluginManager
from hir_core.run.stage_context import StageContext
from hir_core.scene import Scene
from hir_core.scene.frames import move_scene
from hir_core.stages.initialization import initialize
from hir_core.testing.captures import StoredPixels
from hir_plugins.initializers.depth.sensor_depth import SensorDepth
from hir_plugins.initializers.hull.visual_hull import VisualHull
from hir_plugins.initializers.options import SensorDepthOptions, VisualHullOptions
from tests.fixtures.made_captures import around, bowl
from tests.fixtures.scenes import looking_at

SIZE = 192
VIEWS = 24


@cache
def true_bowl() -> tuple[np.ndarray, np.ndarray]:
    mesh = bowl()
    return mesh.positions.numpy().astype(np.float64), mesh.faces.numpy()


def true_depth(camera: Camera) -> np.ndarray:
    """Depth (H, W) along the optical axis, 0 beside the bowl."""
    positions, faces = true_bowl()
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    face, weights = MeshQueries(positions.astype(np.float32), faces).first_hits(
        *camera.rays(np.stack([x.ravel(), y.ravel()], axis=1))
    )
    points = (positions[faces[np.maximum(face, 0)]] * weights[..., None]).sum(axis=1)
    return np.where(face >= 0, camera.project(points)[1], 0).reshape(camera.height, camera.width)


def coarser(camera: Camera, factor: int) -> Camera:
    intrinsics = np.diag([1 / factor, 1 / factor, 1]) @ camera.intrinsics
    return replace(camera, intrinsics=intrinsics, width=camera.width // factor, height=camera.height // factor)


Sensor = Callable[[np.ndarray, np.random.Generator], DepthPixels]


def exact(depth: np.ndarray, random: np.random.Generator) -> DepthPixels:
    return DepthPixels(depth.astype(np.float32), (depth > 0).astype(np.float32))


def noisy(depth: np.ndarray, random: np.random.Generator) -> DepthPixels:
    """Independent errors of 0.5 % of the distance, in whole millimetres of an object of two metres."""
    measured = depth * (1 + 0.005 * random.normal(size=depth.shape))
    return exact(np.rint(measured * 1000) / 1000, random)


def partly_wrong(confidence: float, factor: float = 1.5) -> Sensor:
    """In stripes over a third of the picture, depths are `factor` times the true ones, and of this confidence."""

    def sensor(depth: np.ndarray, random: np.random.Generator) -> DepthPixels:
        wrong = np.broadcast_to((np.arange(depth.shape[1]) + random.integers(48)) % 48 < 16, depth.shape)
        marked = np.where(depth > 0, np.where(wrong, confidence, 1.0), 0)
        return DepthPixels(np.where(wrong, depth * factor, depth).astype(np.float32), marked.astype(np.float32))

    return sensor


def capture(sensor: Sensor, factor: int = 1) -> Capture:
    """Photographs from all around; depth maps with 1/`factor` of their resolution."""
    random = np.random.default_rng(0)
    views = []
    for number, eye in enumerate(around(VIEWS, 0.9)):
        camera = looking_at(eye, SIZE, SIZE)
        mask = (true_depth(camera) > 0).astype(np.float32)
        pixels = sensor(true_depth(coarser(camera, factor)), random)
        color = np.full((SIZE, SIZE, 3), 0.5, np.float32) * mask[..., None]
        depth = MeasuredDepth(lambda found=pixels: found)  # type: ignore[misc]
        views.append(View(str(number), camera, StoredPixels(color, mask), depth=depth))
    return Capture(Path("bowl"), tuple(views))


def surface(found: Capture, **options: Any) -> tuple[Scene, SensorDepth]:
    initializer = SensorDepth(SensorDepthOptions(vertex_colors=False, **options))
    scene = initializer.initialize(found, None, Path())[1]
    assert scene is not None
    return scene, initializer


def distance_of_truth(scene: Scene) -> float:
    """Mean distance from points of the true surface, whose radius is about 1, to the surface that was found."""
    from scipy.spatial import cKDTree

    samples = trimesh.Trimesh(*true_bowl(), process=False).sample(20_000, seed=0)
    found = trimesh.Trimesh(scene.mesh.positions.numpy(), scene.mesh.faces.numpy(), process=False).sample(
        60_000, seed=1
    )
    return float(cKDTree(found).query(samples)[0].mean())


@pytest.fixture(scope="module")
def hull_distance() -> float:
    """That of the visual hull, which cannot show the inside of the bowl."""
    scene = VisualHull(VisualHullOptions(vertex_colors=False)).initialize(capture(exact), None, Path())[1]
    assert scene is not None
    return distance_of_truth(scene)


@pytest.mark.parametrize(
    ("sensor", "factor", "times_better"),
    [
        pytest.param(exact, 1, 4, id="exact", marks=pytest.mark.slow),
        pytest.param(noisy, 1, 4, id="noisy", marks=pytest.mark.slow),
        pytest.param(exact, 4, 3, id="coarse", marks=pytest.mark.slow),
        pytest.param(noisy, 4, 3, id="coarse and noisy"),
    ],
)
def test_depths_show_the_inside_of_a_bowl(
    sensor: Sensor, factor: int, times_better: float, hull_distance: float
) -> None:
    scene, initializer = surface(capture(sensor, factor))
    assert distance_of_truth(scene) < hull_distance / times_better
    assert initializer.report()["depth_maps"] == VIEWS
    mesh = trimesh.Trimesh(scene.mesh.positions.numpy(), scene.mesh.faces.numpy(), process=False)
    assert mesh.is_watertight and mesh.volume > 0
    positions, faces = true_bowl()
    assert mesh.volume == pytest.approx(trimesh.Trimesh(positions, faces, process=False).volume, rel=0.35)


@pytest.mark.slow
def test_depths_of_low_confidence_are_as_good_as_none() -> None:
    """The same wrong depths without their low confidence destroy the object."""
    absent, doubted, believed = (
        surface(capture(sensor))[0] for sensor in (partly_wrong(0, 0), partly_wrong(0.2), partly_wrong(1))
    )
    assert doubted.mesh.positions.equal(absent.mesh.positions)
    assert distance_of_truth(doubted) < 0.5 * distance_of_truth(believed)


@pytest.mark.slow
def test_confidence_is_a_weight() -> None:
    """Slightly wrong depths of medium confidence do less harm than those of full confidence."""
    absent, medium, full = (
        distance_of_truth(surface(capture(sensor))[0])
        for sensor in (partly_wrong(0, 0), partly_wrong(0.3, 1.02), partly_wrong(1, 1.02))
    )
    assert absent < medium < full and medium - absent < 0.7 * (full - absent)


@pytest.mark.slow
def test_a_moved_and_scaled_world_gives_the_moved_and_scaled_surface() -> None:
    found = capture(exact, 2)
    transform = np.diag([7.0, 7.0, 7.0, 1.0])
    transform[:3, 3] = 0.5, -1.0, 2.0
    here, there = (surface(c)[0].mesh.positions.numpy() for c in (found, found.transformed(transform)))
    for extreme in (np.min, np.max):
        expected = 7 * extreme(here, axis=0) + transform[:3, 3]
        np.testing.assert_allclose(extreme(there, axis=0), expected, atol=0.15)


def test_views_without_depth_are_masks_alone(hull_distance: float) -> None:
    found = capture(exact)
    few = replace(found, views=tuple(v if i % 2 else replace(v, depth=None) for i, v in enumerate(found.views)))
    scene, initializer = surface(few)
    assert initializer.report()["depth_maps"] == VIEWS // 2
    assert distance_of_truth(scene) < hull_distance / 2
    none = replace(found, views=tuple(replace(v, depth=None) for v in found.views))
    with pytest.raises(CaptureError, match="no photograph has a depth map"):
        surface(none)


@pytest.mark.parametrize("sigma", [0.0, 0.003, 0.03])
def test_noise_is_measured(sigma: float) -> None:
    """On a slanted plane, whose own second differences are nearly zero."""
    x, y = np.meshgrid(np.arange(200.0), np.arange(150.0))
    depth = 4 + 0.002 * x + 0.001 * y + sigma * np.random.default_rng(1).normal(size=x.shape)
    found = depth_noise(DepthPixels(depth.astype(np.float32), np.ones(x.shape, np.float32)))
    assert found == pytest.approx(sigma, rel=0.03, abs=1e-6)


def chain(found: Capture) -> Sequence[str]:
    return PluginManager.discover().suggest_initializers(found)


def test_the_automatic_chain_contains_it_where_there_is_depth() -> None:
    found = capture(exact, 8)
    assert chain(found)[:2] == ["camera_refinement", "sensor_depth"] and "visual_hull" not in chain(found)
    without = chain(replace(found, views=tuple(replace(v, depth=None) for v in found.views)))
    assert without == ["camera_refinement", "visual_hull", "hollows", *chain(found)[2:]]
    assert "sensor_depth" not in chain(replace(found, views=tuple(replace(v, camera=None) for v in found.views)))


@pytest.mark.slow
@pytest.mark.parametrize("scale", ["auto", "as_measured"])
def test_a_run_corrects_depths_that_are_wrong_together(scale: str, tmp_path: Path, hull_distance: float) -> None:
    """The surface is carved by corrected depths, and the geometry stage gets them, in the working frame."""

    def longer(depth: np.ndarray, random: np.random.Generator) -> DepthPixels:
        return exact(depth * 1.02, random)

    given, plugins = capture(longer), PluginManager.discover()
    config = load_config(
        plugins,
        initializers=("sensor_depth",),
        initializer={"sensor_depth": {"vertex_colors": False}},
        depth_maps={"scale": scale, "min_confidence": 0.4},
    )
    found, report = initialize(given, config, StageContext(plugins, tmp_path))
    scene, frames = found.scene, found.frames
    view, inverse = found.capture.views[5], np.linalg.inv(frames.asset_from_working)
    assert view.depth is not None and view.depth.min_confidence == 0.4
    ratio = view.depth.world_per_unit / np.linalg.norm(inverse[:3, 0])
    distance = distance_of_truth(move_scene(scene, frames.asset_from_working))
    document = report.as_document()["depth_scale"]
    if scale == "auto":
        assert ratio * 1.02 == pytest.approx(1, abs=0.0015) and document["factor"] == pytest.approx(ratio)
        assert "they are corrected" in document["sentence"] and distance < hull_distance / 4
    else:
        assert ratio == pytest.approx(1) and document is None and distance > hull_distance / 2
