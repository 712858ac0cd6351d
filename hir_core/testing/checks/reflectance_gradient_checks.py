"""Contracts of reflectance renderers: gradients agree with central differences."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hir_core.testing.checks.reflectance_samples import (
    MANY,
    SIZE,
    mean_over_seeds,
    pixel_grid,
    prepared_for,
    sphere_scene,
)
from hir_core.testing.contract import Subject, contract, require

if TYPE_CHECKING:
    from torch import Tensor


@contract("reflectance_renderer", traits={"material"}, slow=True)
def gradient_by_diffuse_albedo(subject: Subject) -> None:
    """The gradient by diffuse albedo agrees with central differences: within 3 %, and where the renderer is
    stochastic within four standard errors beyond that.
    """
    _compare_gradient(subject, "diffuse_albedo", 0.35, 0.45)


@contract("reflectance_renderer", traits={"material"}, unless={"lambertian"}, slow=True)
def gradient_by_specular_albedo(subject: Subject) -> None:
    """The gradient by specular albedo agrees with central differences: within 3 %, and where the renderer is
    stochastic within four standard errors beyond that.
    """
    _compare_gradient(subject, "specular_albedo", 0.15, 0.25)


@contract("reflectance_renderer", traits={"material"}, unless={"lambertian"}, slow=True)
def gradient_by_roughness(subject: Subject) -> None:
    """The gradient by roughness (GGX α) agrees with central differences: within 3 %, and where the renderer is
    stochastic within four standard errors beyond that.
    """
    _compare_gradient(subject, "roughness", 0.3, 0.5)


@contract("reflectance_renderer", traits={"environment"}, slow=True)
def gradient_by_light(subject: Subject) -> None:
    """The gradient by the light's radiance agrees with central differences: within 3 %, and where the renderer is
    stochastic within four standard errors beyond that.
    """
    _compare_gradient(subject, "radiance", 0.0, 0.0)


def _compare_gradient(subject: Subject, name: str, low: float, high: float) -> None:
    """Along one direction of a parameter: the mean of the gradient by Simpson's rule, exact to the fourth order,
    against the difference of the ends.
    """
    import torch

    from hir_core.testing.scenes import constant_material, looking_at, uneven_light

    light, camera = uneven_light(16), looking_at((0, 1, 4), SIZE)
    material = constant_material("dielectric", 0.4, 0.2, 0.4)
    prepared = prepared_for(subject, sphere_scene(material, light), camera)
    pixels = pixel_grid(step=2)
    weights = torch.rand(len(pixels), 3, generator=torch.Generator().manual_seed(1))
    if name == "radiance":
        step = 0.1 * torch.rand(light.radiance.shape, generator=torch.Generator().manual_seed(2))
        middle = light.radiance
        ends = [middle - step, middle + step]
    else:
        middle = getattr(material, name)
        ends = [torch.full_like(middle, v) for v in (low, high)]

    def value(at: Tensor) -> Tensor:
        if name == "radiance":
            shown = prepared.radiance(material, replace(light, radiance=at), pixels)
        else:
            shown = prepared.radiance(replace(material, **{name: at}), light, pixels)  # type: ignore[arg-type]
        return (shown * weights).sum()

    def slope() -> Tensor:
        total = torch.zeros(())
        for at, part in ((ends[0], 1 / 6), (middle, 4 / 6), (ends[1], 1 / 6)):
            leaf = at.clone().requires_grad_()
            (found,) = torch.autograd.grad(value(leaf), leaf)
            total = total + part * (found * (ends[1] - ends[0])).sum()
        return total

    try:
        gradient, gradient_error = mean_over_seeds(subject, slope, MANY)
    except RuntimeError as error:
        require(False, f"radiance carries no gradient by {name}, though the traits promise it: {error}")
        return
    difference, difference_error = mean_over_seeds(subject, lambda: value(ends[1]) - value(ends[0]), 6 * MANY)
    slack = 4 * float(np.hypot(float(gradient_error), float(difference_error)))
    require(
        abs(float(gradient - difference)) <= 0.03 * abs(float(difference)) + slack,
        f"by {name} the gradient says {float(gradient):.5g}, central differences {float(difference):.5g}"
        + (f" ± {slack / 4:.2g}" if slack else ""),
    )
