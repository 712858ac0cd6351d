"""Regularizers: value and gradient in single precision against double, fast methods against the slow one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from functools import partial
from typing import Any, Final, Literal, get_args, get_origin, get_type_hints

import numpy as np
import torch
from torch import Tensor

from hir_core.scene import EnvironmentMap, Material, Scene
from hir_core.testing.scenes import leaves, sphere, uneven_light, with_leaves
from hir_plugins.commands.bench.bench_options import BenchOptions
from hir_plugins.commands.bench.measurement import measure
from hir_plugins.commands.bench.results.bench_result import Case, Row, Timing

SPHERE_RINGS: Final = (36, 72, 144)
"""Spheres of 5k, 20k and 82k triangles; their textures have about as many texels as vertices."""

REFERENCE_METHOD: Final = "all_pairs"
"""If a regularizer has an option `method` with this value, it is the reference of the other methods."""


def regularizer_rows(options: BenchOptions) -> Iterator[Row]:
    """Rows for each size, each installed regularizer and each of its methods."""
    components = options.plugins.components("regularizer")
    timings: dict[str, Timing] = {}
    for rings in SPHERE_RINGS[:1] if options.quick else SPHERE_RINGS:
        scene = noisy_scene(rings, torch.float32)
        scene64 = noisy_scene(rings, torch.float64)
        case: Case = {"triangles": len(scene.mesh.faces), "texture": texture_side(scene)}
        for registered in components:
            name, config = registered.component.name, registered.component.config
            if "differentiable" not in registered.component.traits:
                continue
            methods = methods_of(config)
            reference = None
            for method in (REFERENCE_METHOD, *(m for m in methods if m != REFERENCE_METHOD)) if methods else ("",):
                label = f"{name}, {method}" if method else name
                growth = 16 if method == REFERENCE_METHOD else 5
                if options.exceeds_limit(timings.get(label), growth):
                    yield Row(case, label, "reference", None, note=options.omission_note(timings[label]))
                    continue
                component = options.plugins.create("regularizer", name, {"method": method} if method else {})
                if method in ("", REFERENCE_METHOD) and not options.exceeds_limit(timings.get(label), 2 * growth):
                    reference = value_and_gradients(component.prepare(scene64), scene64)
                energy = component.prepare(scene)
                errors = {}
                if reference is not None:
                    errors = relative_differences(value_and_gradients(energy, scene), reference)
                timings[label] = measure(partial(value_and_gradients, energy, scene), options.repeats)
                role: Literal["ours", "reference"] = "reference" if method == REFERENCE_METHOD else "ours"
                yield Row(case, label, role, timings[label], errors)


def noisy_scene(rings: int, dtype: torch.dtype) -> Scene:
    """A bumpy sphere with noise textures; the same values in every precision."""
    random = np.random.default_rng(0)
    mesh = sphere(rings, 2 * rings, dtype=torch.float64)
    displacement = torch.from_numpy(random.normal(scale=0.2 / rings, size=tuple(mesh.positions.shape)))
    mesh = mesh.with_positions((mesh.positions + displacement).to(dtype))
    assert mesh.uvs is not None
    mesh = replace(mesh, uvs=mesh.uvs.to(dtype))
    side = 2 * rings

    def noise(low: float, high: float, channels: int) -> Tensor:
        return torch.from_numpy(random.uniform(low, high, size=(side, side, channels)).astype(np.float32)).to(dtype)

    material = Material("dielectric", noise(0.1, 0.8, 3), noise(0.02, 0.3, 3), noise(0.15, 0.7, 1))
    light = uneven_light()
    return Scene(mesh, material, EnvironmentMap(light.radiance.to(dtype)))


def texture_side(scene: Scene) -> int:
    """Texels along the side of the scene's textures."""
    assert scene.material is not None
    return int(scene.material.diffuse_albedo.shape[0])


def methods_of(config: type) -> tuple[str, ...]:
    """The values of an option `method`, if one of them is the reference; otherwise none."""
    names = {field.name for field in fields(config)}
    hint: Any = get_type_hints(config).get("method") if "method" in names else None
    choices = get_args(hint) if get_origin(hint) is Literal else ()
    return tuple(choices) if REFERENCE_METHOD in choices else ()


def value_and_gradients(energy: Callable[[Scene], Tensor], scene: Scene) -> tuple[float, Tensor]:
    """The energy, and its gradient with respect to all tensors that a fit may change, as one vector (N,)."""
    values = {name: leaf.detach().requires_grad_(True) for name, leaf in leaves(scene).items()}
    total = energy(with_leaves(scene, values))
    gradients = torch.autograd.grad(total, list(values.values()), allow_unused=True, materialize_grads=True)
    return float(total.detach()), torch.cat([gradient.reshape(-1).double() for gradient in gradients])


def relative_differences(result: tuple[float, Tensor], reference: tuple[float, Tensor]) -> dict[str, float]:
    """Relative differences of value and gradient."""
    value = abs(result[0] - reference[0]) / max(abs(reference[0]), 1e-30)
    gradient = float((result[1] - reference[1]).norm() / reference[1].norm().clamp_min(1e-30))
    return {"value error": value, "gradient error": gradient}
