"""Values and gradients of regularizers in what a scene shows of material and light."""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from dataclasses import replace
from typing import TYPE_CHECKING

import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.scene import EnvironmentMap, Material, Scene

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import Energy

MAPS = ("diffuse_albedo", "specular_albedo", "roughness", "metalness")


def parts_of(scene: Scene) -> dict[str, Tensor]:
    """The tensors of material and light that a term may depend on, by name."""
    assert scene.material is not None and scene.environment is not None
    maps = {name: getattr(scene.material, name) for name in MAPS}
    return {name: value for name, value in maps.items() if value is not None} | {"radiance": scene.environment.radiance}


def with_parts(scene: Scene, parts: Mapping[str, Tensor]) -> Scene:
    """The scene with other tensors for some of `parts_of`."""
    material, light = scene.material, scene.environment
    assert isinstance(material, Material) and isinstance(light, EnvironmentMap)
    maps = {name: value for name, value in parts.items() if name in MAPS}
    radiance = parts.get("radiance", light.radiance)
    return replace(scene, material=replace(material, **maps), environment=replace(light, radiance=radiance))  # type: ignore[arg-type]


def value_and_gradients(energy: Energy, scene: Scene) -> tuple[Float[Tensor, ""], dict[str, Tensor]]:
    """The value of a term at a scene, and its gradient by each of `parts_of` that it depends on."""
    leaves = {name: part.detach().clone().requires_grad_() for name, part in parts_of(scene).items()}
    with torch.enable_grad():
        value = energy(with_parts(scene, leaves))
        if not value.requires_grad:
            return value, {}
        found = torch.autograd.grad(value, list(leaves.values()), allow_unused=True)
    return value.detach(), {name: g for name, g in zip(leaves, found, strict=True) if g is not None}


def why_without_effect(scene: Scene, gradients: Mapping[str, Tensor], traits: AbstractSet[str] | None) -> str:
    """Why a term with these gradients at the fitted `scene` had no effect, and what to do; empty where it had one.

    `traits`: what the solver knew of the term; None after gradient steps, which use no traits.
    """
    if not gradients:
        return "depends on neither material nor light: it has no effect here; remove it"
    maps = sorted(set(gradients) - {"radiance"})
    if maps and traits is not None and "material" not in traits:
        return (
            f"depends on {' and '.join(maps)}, but lacks the trait 'material': the solver fitted the material without "
            "it; add the trait to its descriptor"
        )
    parts = parts_of(scene)
    constant = [name for name in maps if parts[name].ndim == 1]
    if constant and not any(bool(gradient.any()) for gradient in gradients.values()):
        return (
            f"has no effect on the model of this run, whose {' and '.join(constant)} is one value for the whole "
            "surface; remove it, or choose a model with maps by reflectance.model"
        )
    return ""


def with_known_gradient(energy: Energy, scene: Scene) -> Float[Tensor, ""]:
    """`energy(scene)` whose gradient is computed at once, so that the time of a term can be measured in one place.

    It reaches all of `parts_of(scene)` that carry gradients, and nothing else.
    """
    parts = parts_of(scene)
    if not torch.is_grad_enabled() or not any(part.requires_grad for part in parts.values()):
        return energy(scene)
    value, gradients = value_and_gradients(energy, scene)
    return _Known.apply(value, [gradients.get(name) for name in parts], *parts.values())


class _Known(torch.autograd.Function):
    @staticmethod
    def forward(ctx, value, gradients, *parts):  # type: ignore[no-untyped-def]
        ctx.gradients = gradients
        return value.clone()

    @staticmethod
    def backward(ctx, outer):  # type: ignore[no-untyped-def]
        return None, None, *(None if g is None else outer * g for g in ctx.gradients)
