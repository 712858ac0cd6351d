"""Remaining error of a fit on a true mesh: `python -m benchmarks.remaining_error CAPTURE` (spot or avocado).

The task of `hir bench reflectance`, judged as there, with one thing after another given more than the defaults give it,
and at last what was rendered in place of the fit: what is left then is pixels, noise and another renderer's habits.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from hir_exporters.conventions import direction_to_latlong_uv
from torch import Tensor
from torch.nn.functional import interpolate

from benchmarks.reflectance_task import Task, task_from_arguments
from benchmarks.true_materials import true_scene
from hir_core.plugins.interfaces import ReflectanceSolver
from hir_core.rendering.light_files import load_light
from hir_core.scene import EnvironmentMap, Scene
from hir_plugins.commands.bench.suites.reflectance_fits import DOWNSAMPLE, FITTED_MODEL
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_pyramid import texel_directions


@dataclass(frozen=True)
class Variant:
    """One change to the task."""

    name: str
    change: Callable[[Scene], Scene] = lambda scene: scene
    options: dict[str, Any] = field(default_factory=dict)
    effort: float = 1.0
    normals: bool = False
    known_light: bool = False


def main() -> None:
    task = task_from_arguments(__doc__)
    for variant in variants(task):
        began = time.perf_counter()
        found = fitted(task, variant)
        task.row(variant.name, time.perf_counter() - began, found)
    truth = true_scene(task.path, task.evaluator.captures["test"])
    assert truth.material is not None
    if truth.material.normal is not None:
        smooth = replace(truth, material=replace(truth.material, normal=None))
        task.row("what was rendered, without its normal map", None, smooth)
    task.row("what was rendered", None, truth)


def variants(task: Task) -> Iterator[Variant]:
    """The changes; all start from the same scene."""
    yield Variant("as it is")
    yield Variant("textures of twice the side", finer_textures)
    yield Variant("a light of 128×256", lambda scene: with_light(scene, finer(_light(scene).radiance)))
    yield Variant("32 directions of a lobe", options={"samples": 32, "texture_samples": 16})
    yield Variant("24,000 cells", options={"cache_cells": 24_000})
    yield Variant("a million pixels", options={"pixels": 1_000_000})
    yield Variant("four times the steps", effort=4.0)
    yield Variant("a normal map", normals=True)
    source = task.evaluator.captures["test"].environment
    if source is not None:
        known = load_light(source, task.train.world_from_source)
        yield Variant("the true light", lambda scene: with_light(scene, seen_from(known, 64)), known_light=True)


def fitted(task: Task, variant: Variant) -> Scene:
    """The scene of a fit to all training views."""
    renderer = task.plugins.create("reflectance_renderer", "transport_ggx", variant.options)
    solver = renderer.prepare(variant.change(task.start), task.train, DOWNSAMPLE)
    assert isinstance(solver, ReflectanceSolver)
    every = range(len(task.train.views))
    spec = replace(FITTED_MODEL, light_is_known=variant.known_light)
    fit = solver.fit(spec, None, every, variant.effort, lambda _: None)
    if variant.normals:
        fit = solver.fit(replace(spec, normals="map"), fit, every, variant.effort, lambda _: None)
    return solver.scene(fit, every, lambda _: None).scene


def finer_textures(scene: Scene) -> Scene:
    """Room for twice the texels along a side."""
    assert scene.material is not None
    return replace(scene, material=replace(scene.material, diffuse_albedo=finer(scene.material.diffuse_albedo)))


def finer(image: Tensor) -> Tensor:
    """Twice the rows and columns."""
    return interpolate(image.permute(2, 0, 1)[None], scale_factor=2)[0].permute(1, 2, 0).contiguous()


def with_light(scene: Scene, radiance: Tensor) -> Scene:
    """The same under another light in the world's axes."""
    return replace(scene, environment=replace(_light(scene), radiance=radiance))


def seen_from(light: EnvironmentMap, rows: int) -> Tensor:
    """A light in the world's axes (rows, 2·rows, 3): means of eight by eight samples per texel."""
    fine = 8 * rows
    assert light.to_world is not None
    directions = texel_directions(fine, 2 * fine) @ light.to_world
    u, v = torch.from_numpy(direction_to_latlong_uv(directions.numpy())).unbind(1)
    height, width = light.radiance.shape[:2]
    row, column = (v * height).long().clamp(0, height - 1), (u * width).long().clamp(0, width - 1)
    looked = light.radiance[row, column].reshape(1, fine, 2 * fine, 3).permute(0, 3, 1, 2)
    return torch.nn.functional.avg_pool2d(looked, 8)[0].permute(1, 2, 0).contiguous()


def _light(scene: Scene) -> EnvironmentMap:
    assert scene.environment is not None
    return scene.environment


if __name__ == "__main__":
    main()
