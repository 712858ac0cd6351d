"""Stock Mitsuba on a true mesh: path-traced gradients (`prb`) of a principled BSDF's textures and a lat-long light.

Two recipes: the paper's (Zhu et al. 2023: a quarter of the resolution, 4 paths per pixel, one view per step, learning
rate 1e-4), and a tuned one (half the resolution, 16 paths, learning rate 2e-2 to 2e-3). A fit ends after a time limit
that includes compilation.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Capture
from hir_core.metrics import OBJECT_COVERAGE, composite, mean, psnr
from hir_core.scene import Scene
from hir_plugins.commands.bench.bench_options import BenchOptions
from hir_plugins.commands.bench.measurement import Stopwatch
from hir_plugins.commands.bench.peers.projective import sensor
from hir_plugins.commands.bench.results.bench_result import Case, Row


@dataclass(frozen=True)
class Recipe:
    """The settings of a fit with stock Mitsuba."""

    name: str
    side: int
    """Side of the fitted images in pixels."""
    samples: int
    learning_rate: float
    learning_rate_end: float
    loss_weight: float
    """Of the L1 term; it hardly changes the steps of Adam."""
    light_size: tuple[int, int]
    """Rows and columns."""


PAPER: Final = Recipe("the paper's recipe in stock Mitsuba", 128, 4, 1e-4, 1e-4, 0.1, (128, 512))
TUNED: Final = Recipe("stock Mitsuba, tuned", 256, 16, 2e-2, 2e-3, 1.0, (64, 128))
TIME_LIMITS_S: Final = (60.0, 120.0)
TEXTURE_SIDE: Final = 512
FITTED_PARAMETERS: Final = ("base_color.data", "bsdf.roughness.value", "bsdf.specular", "light.data")
EVALUATED_VIEWS: Final = 4
EVALUATED_SAMPLES: Final = 64


def stock_rows(
    scene: Scene,
    train: Capture,
    test: Capture,
    case: Case,
    path: Path,
    bench_options: BenchOptions,
    time_limits_s: Sequence[float] = TIME_LIMITS_S,
) -> Iterator[Row]:
    """A row for each recipe and each time limit of at most twice the limit in the options."""
    for recipe in (PAPER, TUNED):
        for seconds in time_limits_s:
            budget = {**case, "budget": f"{seconds:.0f} s"}
            if seconds > 2 * bench_options.limit_seconds:
                yield Row(budget, recipe.name, "peer", None, note="omitted: above the limit")
                continue
            stopwatch = Stopwatch(memory=False)
            unseen_db, steps = fit(scene, train, test, recipe, seconds)
            timing = stopwatch.timing()
            note = f"{steps} steps at {recipe.side}², evaluated at that size too"
            yield Row(budget, recipe.name, "peer", timing, {"unseen dB": unseen_db}, note)


def fit(scene: Scene, train: Capture, test: Capture, recipe: Recipe, seconds: float) -> tuple[float, int]:
    """Mean PSNR over object pixels of a few unseen views after `seconds` of fitting, and the number of steps."""
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    mi.set_log_level(mi.LogLevel.Error)
    start = time.perf_counter()
    mi_scene = textured_mi_scene(mi, scene, recipe)
    parameters = mi.traverse(mi_scene)
    keys = [key for key, _ in parameters if key.endswith(FITTED_PARAMETERS)]
    optimizer = cast(Any, mi.ad).Adam(lr=recipe.learning_rate)
    for key in keys:
        optimizer[key] = parameters[key]
    parameters.update(optimizer)
    integrator = mi.load_dict({"type": "prb", "max_depth": 3, "hide_emitters": True})
    sensors, images = _training_images(mi, train, recipe.side)
    random, step = np.random.default_rng(0), 0
    while time.perf_counter() - start < seconds:
        share = (time.perf_counter() - start) / seconds
        optimizer.set_learning_rate(recipe.learning_rate * (recipe.learning_rate_end / recipe.learning_rate) ** share)
        view = int(random.integers(len(sensors)))
        image = mi.render(
            mi_scene, parameters, sensor=sensors[view], integrator=integrator, spp=recipe.samples, seed=mi.UInt32(step)
        )
        color = image[:, :, :3]
        dr.backward(recipe.loss_weight * dr.sum(dr.abs(color - images[view]), axis=None))
        optimizer.step()
        for key in keys:
            optimizer[key] = dr.clip(optimizer[key], 1e-3, 1e3 if key.endswith("light.data") else 1.0)
        parameters.update(optimizer)
        step += 1
    return _mean_object_psnr(mi, mi_scene, integrator, test, recipe.side), step


def textured_mi_scene(mi: Any, scene: Scene, recipe: Recipe) -> Any:
    """The mesh with a grey texture under a uniform lat-long light."""
    mesh = scene.mesh
    assert mesh.uvs is not None and mesh.topology.uv_faces is not None
    corners, uv_corners = mesh.faces.numpy().reshape(-1), mesh.topology.uv_faces.numpy().reshape(-1)
    pairs, index = np.unique(np.stack([corners, uv_corners], 1), axis=0, return_inverse=True)
    rows, columns = recipe.light_size
    grey = mi.Bitmap(np.full((TEXTURE_SIDE, TEXTURE_SIDE, 3), 0.5, np.float32))
    light = mi.Bitmap(np.full((rows, columns, 3), 0.5, np.float32))
    surface = mi.Properties()
    surface["bsdf"] = mi.load_dict(
        {
            "type": "principled",
            "specular": 0.5,
            "roughness": 0.3,
            "base_color": {"type": "bitmap", "bitmap": grey, "raw": True},
        }
    )
    shape = mi.Mesh(
        "object", len(pairs), len(mesh.faces), has_vertex_normals=True, has_vertex_texcoords=True, props=surface
    )
    arrays = {
        "vertex_positions": mesh.positions.numpy()[pairs[:, 0]],
        "vertex_normals": mesh.normals.numpy()[pairs[:, 0]],
        "vertex_texcoords": mesh.uvs.numpy()[pairs[:, 1]],
        "faces": index.astype(np.uint32),
    }
    parameters = mi.traverse(shape)
    for name, values in arrays.items():
        parameters[name] = np.ascontiguousarray(values, np.uint32 if name == "faces" else np.float32).ravel()
    parameters.update()
    return mi.load_dict({"type": "scene", "object": shape, "light": {"type": "envmap", "bitmap": light}})


def _training_images(mi: Any, capture: Capture, side: int) -> tuple[list[Any], list[Any]]:
    """Sensors, and linear photographs over black at about `side` pixels."""
    sensors, images = [], []
    for view, camera in zip(capture.views, capture.cameras, strict=True):
        factor = max(1, camera.width // side)
        pixels = view.pixels().downsampled(factor)
        assert pixels.mask is not None
        sensors.append(mi.load_dict(sensor(mi, camera.downsampled(factor))))
        images.append(mi.TensorXf(np.ascontiguousarray(pixels.color_linear * pixels.mask[..., None])))
    return sensors, images


def _mean_object_psnr(mi: Any, mi_scene: Any, integrator: Any, test: Capture, side: int) -> float:
    from hir_core.rendering.view_selection import evenly_spaced_indices

    values: list[float | None] = []
    for i in evenly_spaced_indices(len(test.views), EVALUATED_VIEWS):
        camera = test.cameras[i]
        factor = max(1, camera.width // side)
        pixels = test.views[i].pixels().downsampled(factor)
        view = mi.load_dict(sensor(mi, camera.downsampled(factor)))
        image = np.array(mi.render(mi_scene, sensor=view, integrator=integrator, spp=EVALUATED_SAMPLES))[..., :3]
        assert pixels.mask is not None
        full: NDArray[np.float32] = np.ones(pixels.mask.shape, np.float32)
        truth = composite(pixels.color_linear, pixels.mask)
        values.append(psnr(composite(image, full), truth, pixels.mask > OBJECT_COVERAGE))
    return mean(values) or 0.0
