"""Initial values of a fit: from the photographs, or from the fit of another model."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from hir_plugins.reflectance_renderers.transport_ggx.fit.final_albedo import ALBEDO_HIGH, ALBEDO_LOW
from hir_plugins.reflectance_renderers.transport_ggx.fit.observed_pixels import ObservedPixels
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from hir_plugins.reflectance_renderers.transport_ggx.operator.camera_light import irradiance_of
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport

MIN_INITIAL_ALBEDO, MAX_INITIAL_ALBEDO = 0.02, 0.95
MEAN_WEIGHT = 0.05
"""Weight of the mean albedo at a vertex, as a fraction of the mean weight of a vertex's pixels."""
INDIRECT_ITERATIONS = 4
"""Iterations of darker albedos and the indirect light that they cause; each reduces the change by the albedo."""


def initial_albedo(
    transport: Transport,
    observed: ObservedPixels,
    light: Float[Tensor, "H W 3"],
    uniform: bool,
    rotation: Float[Tensor, "N 3 3"] | None,
    samples: int,
) -> Float[Tensor, "V 3"]:
    """Mean colour over mean irradiance, or that of each vertex, near the mean where few pixels see it.

    If the light is unknown, the albedo should be `uniform`: gradient steps do not remove shading from an initial
    albedo. `rotation` and `samples` are those of a light that moves with the camera.
    """
    count = len(transport.surface.positions)
    if len(observed) == 0:
        return torch.full((count, 3), 0.5, device=light.device)
    vertices, cells = transport.interpolation(observed.points)
    sources, irradiance = transport.sources(light, torch.zeros(count, 3, device=light.device), 0)
    arriving = cells @ irradiance
    if rotation is not None:
        arriving = irradiance_of(transport, observed.points, samples, rotation, sources)
    mean = observed.color.mean(dim=0) / (arriving / torch.pi).mean(dim=0).clamp_min(1e-6)
    if uniform:
        return mean.clamp(MIN_INITIAL_ALBEDO, MAX_INITIAL_ALBEDO).expand(count, 3).contiguous()
    color = vertices.transposed @ observed.color
    white = vertices.transposed @ (arriving / torch.pi)
    weight = MEAN_WEIGHT * white.mean()
    albedo = (color + weight * mean) / (white + weight).clamp_min(1e-9)
    return albedo.clamp(MIN_INITIAL_ALBEDO, MAX_INITIAL_ALBEDO)


def without_indirect(transport: Transport, base: Parameters, bounces: int) -> Float[Tensor, "V 3"]:
    """Logits of albedos that with indirect light give the radiance that those of `base` give without it.

    Of a metal's base colour they stay: irradiance says nothing about its reflections.
    """
    with torch.no_grad():
        original = base.base_color
        _, direct = transport.sources(base.radiance, original, 0)
        albedo = original
        for _ in range(INDIRECT_ITERATIONS):
            _, irradiance = transport.sources(base.radiance, albedo, bounces)
            share = direct / irradiance.clamp_min(1e-12)
            share = torch.where(irradiance > 0, share, torch.ones_like(share))
            share = share[transport.irradiance_cache.of_vertex]
            if base.metalness is not None:
                share = share + base.metal_share * (1 - share)
            albedo = original * share
        return torch.logit(albedo.clamp(ALBEDO_LOW, ALBEDO_HIGH))
