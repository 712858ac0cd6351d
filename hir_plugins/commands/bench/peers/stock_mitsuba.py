"""Stock Mitsuba on a true mesh: path-traced gradients (`prb`) of a principled BSDF's textures and a panorama.

Two recipes: the paper's own (Zhu et al. 2023: a quarter of the resolution, 4 paths, one view a step, rate 1e-4), and
a tuned one (half, 16 paths, rate 2e-2 falling to 2e-3). Each is stopped after given seconds, compilation included.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Capture
from hir_core.metrics import OBJECT_COVERAGE, composite, mean, psnr
from hir_core.scene import Scene
from hir_plugins.commands.bench.bench_plan import Plan
from hir_plugins.commands.bench.peers.projective import sensor
from hir_plugins.commands.bench.results.bench_result import Case, Row, Timing


@dataclass(frozen=True)
class Recipe:
    """How stock Mitsuba is asked to fit."""

    name: str
    side: int
    """Pixels of the images that are fitted."""
    samples: int
    rate: float
    rate_end: float
    weight: float
    """Of the L1 term; Adam hardly feels it."""
    light: tuple[int, int]


PAPER: Final = Recipe("the paper's recipe in stock Mitsuba", 128, 4, 1e-4, 1e-4, 0.1, (128, 512))
TUNED: Final = Recipe("stock Mitsuba, tuned", 256, 16, 2e-2, 2e-3, 1.0, (64, 128))
SECONDS: Final = (60.0, 120.0)
TEXTURE: Final = 512
FITTED: Final = ("base_color.data", "bsdf.roughness.value", "bsdf.specular", "light.data")
EVALUATED_VIEWS: Final = 4
EVALUATED_SAMPLES: Final = 64


def stock_rows(scene: Scene, train: Capture, test: Capture, case: Case, path: Path, plan: Plan) -> Iterator[Row]:
    """A row for each recipe and each span of time that the plan's limit allows."""
    for recipe in (PAPER, TUNED):
        for seconds in SECONDS:
            budget = {**case, "budget": f"{seconds:.0f} s"}
            if seconds > 2 * plan.limit_seconds:
                yield Row(budget, recipe.name, "peer", None, note="left out: above the limit")
                continue
            began, cpu = time.perf_counter(), time.process_time()
            level, steps = fit(scene, train, test, recipe, seconds)
            spent = time.perf_counter() - began
            timing = Timing(spent, spent, spent, 1, time.process_time() - cpu)
            note = f"{steps} steps at {recipe.side}², judged too"
            yield Row(budget, recipe.name, "peer", timing, {"unseen dB": level}, note)


def fit(scene: Scene, train: Capture, test: Capture, recipe: Recipe, seconds: float) -> tuple[float, int]:
    """Mean PSNR over object pixels of a few unseen views after so many seconds, and the steps that fitted into them."""
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    mi.set_log_level(mi.LogLevel.Error)
    began = time.perf_counter()
    stage = textured_stage(mi, scene, recipe)
    parameters = mi.traverse(stage)
    keys = [key for key, _ in parameters if key.endswith(FITTED)]
    optimizer = cast(Any, mi.ad).Adam(lr=recipe.rate)
    for key in keys:
        optimizer[key] = parameters[key]
    parameters.update(optimizer)
    integrator = mi.load_dict({"type": "prb", "max_depth": 3, "hide_emitters": True})
    sensors, pictures = _photographs(mi, train, recipe.side)
    random, step = np.random.default_rng(0), 0
    while time.perf_counter() - began < seconds:
        share = (time.perf_counter() - began) / seconds
        optimizer.set_learning_rate(recipe.rate * (recipe.rate_end / recipe.rate) ** share)
        view = int(random.integers(len(sensors)))
        image = mi.render(
            stage, parameters, sensor=sensors[view], integrator=integrator, spp=recipe.samples, seed=mi.UInt32(step)
        )
        color = image[:, :, :3]
        dr.backward(recipe.weight * dr.sum(dr.abs(color - pictures[view]), axis=None))
        optimizer.step()
        for key in keys:
            optimizer[key] = dr.clip(optimizer[key], 1e-3, 1e3 if key.endswith("light.data") else 1.0)
        parameters.update(optimizer)
        step += 1
    return _judged(mi, stage, integrator, test, recipe.side), step


def textured_stage(mi: Any, scene: Scene, recipe: Recipe) -> Any:
    """The mesh with a grey texture of its own under a grey panorama."""
    mesh = scene.mesh
    assert mesh.uvs is not None and mesh.topology.uv_faces is not None
    corners, uv_corners = mesh.faces.numpy().reshape(-1), mesh.topology.uv_faces.numpy().reshape(-1)
    pairs, index = np.unique(np.stack([corners, uv_corners], 1), axis=0, return_inverse=True)
    rows, columns = recipe.light
    grey = mi.Bitmap(np.full((TEXTURE, TEXTURE, 3), 0.5, np.float32))
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


def _photographs(mi: Any, capture: Capture, side: int) -> tuple[list[Any], list[Any]]:
    """Sensors, and linear photographs over black, at about `side` pixels."""
    sensors, pictures = [], []
    for view, camera in zip(capture.views, capture.cameras, strict=True):
        factor = max(1, camera.width // side)
        pixels = view.pixels().downsampled(factor)
        assert pixels.mask is not None
        sensors.append(mi.load_dict(sensor(mi, camera.downsampled(factor))))
        pictures.append(mi.TensorXf(np.ascontiguousarray(pixels.color_linear * pixels.mask[..., None])))
    return sensors, pictures


def _judged(mi: Any, stage: Any, integrator: Any, test: Capture, side: int) -> float:
    from hir_core.evaluation import spread

    found: list[float | None] = []
    for i in spread(len(test.views), EVALUATED_VIEWS):
        camera = test.cameras[i]
        factor = max(1, camera.width // side)
        pixels = test.views[i].pixels().downsampled(factor)
        view = mi.load_dict(sensor(mi, camera.downsampled(factor)))
        image = np.array(mi.render(stage, sensor=view, integrator=integrator, spp=EVALUATED_SAMPLES))[..., :3]
        assert pixels.mask is not None
        full: NDArray[np.float32] = np.ones(pixels.mask.shape, np.float32)
        truth = composite(pixels.color_linear, pixels.mask)
        found.append(psnr(composite(image, full), truth, pixels.mask > OBJECT_COVERAGE))
    return mean(found) or 0.0
