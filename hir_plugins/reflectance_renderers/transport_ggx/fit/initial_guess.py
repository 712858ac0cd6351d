"""Albedos that a fit begins with: of the photographs, or of an earlier fit whose model had less light."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from hir_plugins.reflectance_renderers.transport_ggx.fit.final_albedo import ALBEDO_HIGH, ALBEDO_LOW
from hir_plugins.reflectance_renderers.transport_ggx.fit.observed_pixels import Photographed
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Unknowns
from hir_plugins.reflectance_renderers.transport_ggx.operator.camera_light import irradiance_of
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport

DARKEST, BRIGHTEST = 0.02, 0.95
"""Of a first albedo."""
ROUNDS_INDIRECT = 4
"""Of darker albedos and the less indirect light that they make; the change falls by the albedo with each."""


def albedo_of_photographs(
    transport: Transport,
    photographs: Photographed,
    light: Float[Tensor, "H W 3"],
    alike: bool,
    rotation: Float[Tensor, "N 3 3"] | None,
    samples: int,
) -> Float[Tensor, "V 3"]:
    """Mean colour over mean irradiance, or each vertex's own, held near the mean where few pixels see it.

    While the light is sought all should begin `alike`: shading that an albedo begins with it never gives back.
    `rotation` and `samples`: of a light that the camera carries.
    """
    count = len(transport.surface.positions)
    if len(photographs) == 0:
        return torch.full((count, 3), 0.5, device=light.device)
    vertices, cells = transport.interpolation(photographs.points)
    sources, irradiance = transport.sources(light, torch.zeros(count, 3, device=light.device), 0)
    arriving = cells @ irradiance
    if rotation is not None:
        arriving = irradiance_of(transport, photographs.points, samples, rotation, sources)
    mean = photographs.color.mean(dim=0) / (arriving / torch.pi).mean(dim=0).clamp_min(1e-6)
    if alike:
        return mean.clamp(DARKEST, BRIGHTEST).expand(count, 3).contiguous()
    shown = vertices.transposed @ photographs.color
    white = vertices.transposed @ (arriving / torch.pi)
    weight = 0.05 * white.mean()
    return ((shown + weight * mean) / (white + weight).clamp_min(1e-9)).clamp(DARKEST, BRIGHTEST)


def without_indirect(transport: Transport, base: Unknowns, bounces: int) -> Float[Tensor, "V 3"]:
    """Logits of the albedos that show with indirect light what those of a fit without it show."""
    with torch.no_grad():
        shown = base.diffuse_albedo
        _, direct = transport.sources(base.radiance, shown, 0)
        albedo = shown
        for _ in range(ROUNDS_INDIRECT):
            _, irradiance = transport.sources(base.radiance, albedo, bounces)
            share = direct / irradiance.clamp_min(1e-12)
            albedo = shown * torch.where(irradiance > 0, share, torch.ones_like(share))[transport.cells.of_vertex]
        return torch.logit(albedo.clamp(ALBEDO_LOW, ALBEDO_HIGH))
