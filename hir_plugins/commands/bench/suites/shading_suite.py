"""Shading: fast renderers against path tracing, on scenes by formula."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from hir_core.capture import Capture, Pixels, View
from hir_core.plugins.interfaces import ReflectanceRenderer
from hir_core.rendering.reference_renderer import reference_renderer
from hir_core.scene import EnvironmentMap, Mesh, Scene
from hir_core.testing.scenes import constant_material, looking_at, smooth_sphere, two_spheres, uneven_light
from hir_plugins.commands.bench.bench_options import BenchOptions
from hir_plugins.commands.bench.inputs.bench_shapes import bowl
from hir_plugins.commands.bench.inputs.uniform_pixels import uniform_pixels
from hir_plugins.commands.bench.measurement import measure
from hir_plugins.commands.bench.results.bench_result import Case, Row

IMAGE_SIZE: Final = 48
REFERENCE_PATHS: Final = 2048
PATHS_PER_PIXEL: Final = (16, 64, 256)
GGX_WIDTHS: Final = (0.03, 0.1, 0.3, 0.6)
Eye = tuple[float, float, float]
SHADED_MESHES: Final[Mapping[str, tuple[Callable[[], Mesh], Eye]]] = {
    "convex": (lambda: smooth_sphere(4), (0.0, 1.0, 4.0)),
    "two spheres": (lambda: two_spheres(4), (0.0, 1.0, 4.0)),
    "bowl": (bowl, (0.0, 3.2, 2.4)),
}
"""Each mesh, and the camera position that sees what it is for: a shadow between spheres, the inside of the bowl."""


def shading_rows(options: BenchOptions) -> Iterator[Row]:
    """Each renderer without the trait `reference` against the one that has it, by mesh, light and GGX width."""
    components = options.plugins.components("reflectance_renderer")
    fast = [r.component.name for r in components if "reference" not in r.component.traits and not r.missing]
    for mesh_name, (make_mesh, eye) in SHADED_MESHES.items():
        mesh = make_mesh()
        uniform = uniform_pixels(mesh, looking_at(eye, IMAGE_SIZE))
        for light_name, light in lights().items():
            for alpha in GGX_WIDTHS[1:2] if options.quick else GGX_WIDTHS:
                scene = Scene(mesh, constant_material("dielectric", 0.4, 0.2, alpha), light)
                case: Case = {"scene": mesh_name, "light": light_name, "α": alpha}
                name, path_tracer = reference_renderer(
                    options.plugins, "", {"samples": REFERENCE_PATHS, "max_depth": 2}
                )
                reference = render_radiance(path_tracer, scene, eye)
                for paths in () if options.quick else PATHS_PER_PIXEL:
                    _, coarse = reference_renderer(options.plugins, "", {"samples": paths, "max_depth": 2})
                    timing = measure(partial(render_radiance, coarse, scene, eye), min(options.repeats, 3))
                    errors = radiance_errors(render_radiance(coarse, scene, eye), reference, uniform)
                    yield Row(case, f"{name}, {paths} paths", "reference", timing, errors)
                for fast_name in fast:
                    renderer = options.plugins.create("reflectance_renderer", fast_name, {})
                    timing = measure(partial(render_radiance, renderer, scene, eye), min(options.repeats, 3))
                    errors = radiance_errors(render_radiance(renderer, scene, eye), reference, uniform)
                    yield Row(case, fast_name, "ours", timing, errors)


def lights() -> Mapping[str, EnvironmentMap]:
    """A light without small sources, and the same with a sun of one texel."""
    smooth = uneven_light()
    radiance = smooth.radiance.clone()
    radiance[8, 30] = 500.0
    return {"smooth": smooth, "sun": EnvironmentMap(radiance)}


def render_radiance(renderer: ReflectanceRenderer, scene: Scene, eye: Eye) -> torch.Tensor:
    """Radiance (IMAGE_SIZE², 3) through every pixel of one camera at `eye`, preparation included."""
    assert scene.material is not None and scene.environment is not None
    shape = (IMAGE_SIZE, IMAGE_SIZE)
    pixels = Pixels(np.zeros((*shape, 3), np.float32), np.ones(shape, np.float32), np.zeros(shape, bool))
    capture = Capture(Path("formula"), (View("0", looking_at(eye, IMAGE_SIZE), lambda: pixels),))
    indices = torch.tensor([(0, x, y) for y in range(IMAGE_SIZE) for x in range(IMAGE_SIZE)])
    torch.manual_seed(0)
    with torch.no_grad():
        return renderer.prepare(scene, capture).radiance(scene.material, scene.environment, indices)


def radiance_errors(radiance: torch.Tensor, reference: torch.Tensor, uniform: NDArray[np.bool_]) -> dict[str, float]:
    """Mean absolute and mean signed difference where both see the surface, relative to the mean radiance.

    Both over the `uniform` pixels. `outline error` is the mean absolute difference of the other pixels: a fast renderer
    shades a pixel's centre, and the reference the mean over the parts of the surface that the pixel shows.
    """
    visible = (reference.sum(1) > 0) & (radiance.sum(1) > 0)
    relative = (radiance - reference) / reference[visible].mean()
    one_part = torch.from_numpy(uniform)
    inside, outline = relative[visible & one_part], relative[visible & ~one_part]
    return {
        "mean error": float(inside.abs().mean()),
        "bias": float(inside.mean()),
        "outline error": float(outline.abs().mean()),
    }
