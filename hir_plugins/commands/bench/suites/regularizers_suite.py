"""Regularizers: value and gradient in single precision against double, a fast method against the slow one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from functools import partial
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np
import torch
from torch import Tensor

from hir_core.scene import EnvironmentMap, Material, Scene
from hir_core.testing.scenes import leaves, sphere, uneven_light, with_leaves
from hir_plugins.commands.bench.bench_plan import Plan
from hir_plugins.commands.bench.measurement import measure
from hir_plugins.commands.bench.results.bench_result import Case, Row, Timing

RINGS = (36, 72, 144)
"""Spheres of 5k, 20k and 82k triangles; their textures have as many texels as vertices, about."""

SLOW_METHOD = "all_pairs"
"""A regularizer with an option `method` is judged by this one, where it has it."""


def regularizers(plan: Plan) -> Iterator[Row]:
    """Rows for each size and each regularizer that is installed, and for each of its methods."""
    components = plan.plugins.components("regularizer")
    last: dict[str, Timing] = {}
    for rings in RINGS[:1] if plan.quick else RINGS:
        scene = noisy_scene(rings, torch.float32)
        double = noisy_scene(rings, torch.float64)
        case: Case = {"triangles": len(scene.mesh.faces), "texture": scene_texture(scene)}
        for found in components:
            name, config = found.component.name, found.component.config
            if "differentiable" not in found.component.traits:
                continue
            methods = methods_of(config)
            truth = None
            for method in (SLOW_METHOD, *(m for m in methods if m != SLOW_METHOD)) if methods else ("",):
                label = f"{name}, {method}" if method else name
                growth = 16 if method == SLOW_METHOD else 5
                if plan.too_slow(last.get(label), growth):
                    yield Row(case, label, "reference", None, note=plan.left_out(last[label]))
                    continue
                component = plan.plugins.create("regularizer", name, {"method": method} if method else {})
                if method in ("", SLOW_METHOD) and not plan.too_slow(last.get(label), 2 * growth):
                    truth = value_and_gradients(component.prepare(double), double)
                energy = component.prepare(scene)
                errors = {} if truth is None else compared(value_and_gradients(energy, scene), truth)
                last[label] = measure(partial(value_and_gradients, energy, scene), plan.repeats)
                role: Literal["ours", "reference"] = "reference" if method == SLOW_METHOD else "ours"
                yield Row(case, label, role, last[label], errors)


def noisy_scene(rings: int, dtype: torch.dtype) -> Scene:
    """A bumpy sphere with textures of noise; the same numbers in every precision."""
    random = np.random.default_rng(0)
    mesh = sphere(rings, 2 * rings, dtype=torch.float64)
    push = torch.from_numpy(random.normal(scale=0.2 / rings, size=tuple(mesh.positions.shape)))
    mesh = replace(mesh.with_positions((mesh.positions + push).to(dtype)), uvs=mesh.uvs.to(dtype))  # type: ignore[union-attr]
    side = 2 * rings

    def noise(low: float, high: float, channels: int) -> Tensor:
        return torch.from_numpy(random.uniform(low, high, size=(side, side, channels)).astype(np.float32)).to(dtype)

    material = Material("dielectric", noise(0.1, 0.8, 3), noise(0.02, 0.3, 3), noise(0.15, 0.7, 1))
    light = uneven_light()
    return Scene(mesh, material, EnvironmentMap(light.radiance.to(dtype)))


def scene_texture(scene: Scene) -> int:
    """Side of its textures."""
    assert scene.material is not None
    return int(scene.material.diffuse_albedo.shape[0])


def methods_of(config: type) -> tuple[str, ...]:
    """The choices of an option `method`, where one of them is the slow one."""
    names = {field.name for field in fields(config)}
    hint: Any = get_type_hints(config).get("method") if "method" in names else None
    choices = get_args(hint) if get_origin(hint) is Literal else ()
    return tuple(choices) if SLOW_METHOD in choices else ()


def value_and_gradients(energy: Callable[[Scene], Tensor], scene: Scene) -> tuple[float, Tensor]:
    """The term, and its gradient with respect to all that a fit may move, in one vector."""
    values = {name: leaf.detach().requires_grad_(True) for name, leaf in leaves(scene).items()}
    total = energy(with_leaves(scene, values))
    found = torch.autograd.grad(total, list(values.values()), allow_unused=True, materialize_grads=True)
    return float(total.detach()), torch.cat([g.reshape(-1).double() for g in found])


def compared(found: tuple[float, Tensor], truth: tuple[float, Tensor]) -> dict[str, float]:
    """Relative differences of value and gradient."""
    value = abs(found[0] - truth[0]) / max(abs(truth[0]), 1e-30)
    gradient = float((found[1] - truth[1]).norm() / truth[1].norm().clamp_min(1e-30))
    return {"value error": value, "gradient error": gradient}
