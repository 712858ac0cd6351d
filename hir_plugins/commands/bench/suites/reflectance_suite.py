"""Shading: fast renderers against path tracing, and fits on a true mesh, seconds against error on unseen views."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import torch

from hir_core.capture import Capture, Pixels, View
from hir_core.plugins.interfaces import ReflectanceRenderer
from hir_core.rendering.reference_renderer import reference_renderer
from hir_core.scene import EnvironmentMap, Scene
from hir_core.testing.scenes import constant_material, looking_at, smooth_sphere, two_spheres, uneven_light
from hir_plugins.commands.bench.bench_plan import Plan
from hir_plugins.commands.bench.measurement import measure
from hir_plugins.commands.bench.results.bench_result import Case, Row
from hir_plugins.commands.bench.suites.reflectance_fits import fits

SIZE = 48
TRUE_PATHS = 2048
PATHS = (16, 64, 256)
WIDTHS = (0.03, 0.1, 0.3, 0.6)


def reflectance(plan: Plan) -> Iterator[Row]:
    """Rows of shading by formula; rows of fits for each capture with a true mesh."""
    yield from shading(plan)
    for path in plan.captures:
        yield from fits(path, plan)


def shading(plan: Plan) -> Iterator[Row]:
    """Every renderer without the trait `reference` against the one that has it, by width, concavity and light."""
    components = plan.plugins.components("reflectance_renderer")
    fast = [r.component.name for r in components if "reference" not in r.component.traits and not r.missing]
    meshes = {"convex": smooth_sphere(4), "concave": two_spheres(4)}
    sky = uneven_light()
    sunny = sky.radiance.clone()
    sunny[8, 30] = 500.0
    lights = {"smooth": sky, "sun": EnvironmentMap(sunny)}
    for mesh_name, mesh in meshes.items():
        for light_name, light in lights.items():
            for alpha in WIDTHS[1:2] if plan.quick else WIDTHS:
                scene = Scene(mesh, constant_material("dielectric", 0.4, 0.2, alpha), light)
                case: Case = {"scene": mesh_name, "light": light_name, "α": alpha}
                name, tracer = reference_renderer(plan.plugins, "", {"samples": TRUE_PATHS, "max_depth": 2})
                truth = shaded(tracer, scene)
                for paths in () if plan.quick else PATHS:
                    _, coarse = reference_renderer(plan.plugins, "", {"samples": paths, "max_depth": 2})
                    timing = measure(partial(shaded, coarse, scene), min(plan.repeats, 3))
                    yield Row(
                        case, f"{name}, {paths} paths", "reference", timing, difference(shaded(coarse, scene), truth)
                    )
                for other in fast:
                    renderer = plan.plugins.create("reflectance_renderer", other, {})
                    timing = measure(partial(shaded, renderer, scene), min(plan.repeats, 3))
                    yield Row(case, other, "ours", timing, difference(shaded(renderer, scene), truth))


def shaded(renderer: ReflectanceRenderer, scene: Scene) -> torch.Tensor:
    """Radiance (SIZE², 3) through every pixel of one camera, preparation included."""
    assert scene.material is not None and scene.environment is not None
    blank = Pixels(
        np.zeros((SIZE, SIZE, 3), np.float32), np.ones((SIZE, SIZE), np.float32), np.zeros((SIZE, SIZE), bool)
    )
    capture = Capture(Path("made"), (View("0", looking_at((0, 1, 4), SIZE), lambda: blank),))
    pixels = torch.tensor([(0, x, y) for y in range(SIZE) for x in range(SIZE)])
    torch.manual_seed(0)
    with torch.no_grad():
        return renderer.prepare(scene, capture).radiance(scene.material, scene.environment, pixels)


def difference(found: torch.Tensor, truth: torch.Tensor) -> dict[str, float]:
    """Mean absolute and mean signed difference where both see the surface, relative to the mean radiance."""
    seen = (truth.sum(1) > 0) & (found.sum(1) > 0)
    off, mean = (found - truth)[seen], truth[seen].mean()
    return {"mean error": float(off.abs().mean() / mean), "bias": float(off.mean() / mean)}
