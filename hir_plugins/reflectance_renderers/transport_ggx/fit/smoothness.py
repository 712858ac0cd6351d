"""Smoothness priors of a fit: light, albedo, maps and shading normals."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters

LOG_ALBEDO_NOISE = 0.02
"""Below this difference of log albedo between neighbours the penalty is quadratic (noise, slow change), above linear.
"""
METALNESS_IN_LOG_ALBEDO = 1.0
"""Difference of log albedo that weighs as much as that between metal and dielectric. Both are in one root, so an edge
of the base colour lets metalness change there too."""


@dataclass(frozen=True)
class SmoothnessWeights:
    """Weights of the terms of `smoothness_energy`."""

    light: float = 1e-4
    light_chroma: float = 1e-3
    albedo: float = 1e-3
    maps: float = 3e-3
    normals: float = 0.03
    """Of differences between neighbouring normal offsets: with a thirtieth of it a map on a true mesh imitates noise
    and loses 1.6 dB, with three times as much dents of 18° are lost (docs/studies/normal_maps.md)."""
    normal_prior: float = 5e-4
    """On the length of normal offsets."""
    spacing: float = 1.0
    """Distance of neighbouring values in edges: where values of vertices change together, differences between vertices
    are that much smaller than those between values."""
    metalness_prior: float = 1e-3
    """Of 4·m·(1 − m): a surface is metal or it is not."""


def light_energy(light: Float[Tensor, "TH W 3"], smoothness: float, chroma: float, takes: int = 1) -> Float[Tensor, ""]:
    """Prior of the logarithm of a light: smooth and white. A tint that light or surface could explain goes to the
    surface.

    Of the lights of several takes, one below another, each is smooth in itself.
    """
    image = light.reshape(takes, -1, *light.shape[1:])
    rough = (image - image.roll(1, 2)).square().mean() + (image[:, 1:] - image[:, :-1]).square().mean()
    saturation = (light - light.mean(dim=-1, keepdim=True)).square().mean()
    return smoothness * rough + chroma * saturation


def smoothness_energy(
    parameters: Parameters, weights: SmoothnessWeights, edges: Int[Tensor, "E 2"], takes: int = 1
) -> Float[Tensor, ""]:
    """All smoothness priors of a fit, over the edges between vertices."""
    energy = light_energy(parameters.light, weights.light, weights.light_chroma, takes)
    if parameters.lamp is not None:
        intensity = parameters.lamp[:3]
        energy = energy + weights.light_chroma * (intensity - intensity.mean()).square().mean()
    if weights.albedo and len(edges):
        # albedo is nearly piecewise constant: a gradient that shading explains too is shading
        albedo = torch.nn.functional.logsigmoid(parameters.diffuse)
        change = _differences(albedo, edges).square().sum(dim=1)
        if parameters.metalness is not None and len(parameters.metalness) > 1:
            metal = METALNESS_IN_LOG_ALBEDO * parameters.metal_share
            change = change + _differences(metal, edges)[:, 0].square()
        change = weights.spacing**2 * change
        energy = energy + weights.albedo * ((change + LOG_ALBEDO_NOISE**2).sqrt() - LOG_ALBEDO_NOISE).mean()
    for value in (parameters.specular, parameters.width):
        if value is not None and len(value) > 1:
            energy = energy + weights.maps * weights.spacing**2 * _differences(value, edges).square().mean()
    if parameters.metalness is not None and not parameters.is_metal:
        m = parameters.metal_share
        energy = energy + weights.metalness_prior * (4 * m * (1 - m)).mean()
    if parameters.normal_offset is not None:
        offset = parameters.normal_offset
        change = _differences(offset, edges).square().sum(dim=1)
        energy = energy + weights.normals * weights.spacing**2 * change.mean()
        energy = energy + weights.normal_prior * offset.square().sum(dim=1).mean()
    return energy


def _differences(values: Float[Tensor, "V C"], edges: Int[Tensor, "E 2"]) -> Float[Tensor, "E C"]:
    # the gradient of `index_select` is a third faster than that of an index
    return values.index_select(0, edges[:, 0]) - values.index_select(0, edges[:, 1])
