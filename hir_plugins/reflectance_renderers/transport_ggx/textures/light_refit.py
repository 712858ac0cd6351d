"""The light once more, where texels have lobes of their own: the fit at vertices saw it through one lobe for all."""

from __future__ import annotations

import warnings
from dataclasses import replace

import torch

from hir_plugins.reflectance_renderers.transport_ggx.fit.joint_optimization import light_energy
from hir_plugins.reflectance_renderers.transport_ggx.fit.observed_pixels import Photographed
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import ALPHA_LOW
from hir_plugins.reflectance_renderers.transport_ggx.fit.pixel_batches import ShownPixels, residual
from hir_plugins.reflectance_renderers.transport_ggx.fit.shading_normals import bent
from hir_plugins.reflectance_renderers.transport_ggx.operator.linear_maps import LinearMap
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.textures.brdf_fit import PointValues
from hir_plugins.reflectance_renderers.transport_ggx.textures.per_texel_brdf import LitSurface
from hir_plugins.reflectance_renderers.transport_ggx.textures.texture_shading import gain_and_lobe, irradiance_at

STEPS, RATE = 80, 0.04
"""Of Adam; only the light moves, and it begins where it was fitted."""
HUBER = 0.1
"""In sRGB."""
MOST_PIXELS = 120_000
"""Whose lobes are in memory, some 1 kB each."""


def some_pixels(pixels: Photographed, seed: int) -> Photographed:
    """As many as the light is fitted to."""
    if len(pixels) <= MOST_PIXELS:
        return pixels
    return pixels.take(torch.randperm(len(pixels), generator=torch.Generator().manual_seed(seed))[:MOST_PIXELS])


def with_fitted_light(
    lit: LitSurface, pixels: Photographed, values: PointValues, options: TransportGGXOptions
) -> LitSurface:
    """The surface in the light under which pixels of those `values` come nearest to their photographs."""
    transport, unknowns = lit.transport, lit.unknowns
    shown, exposure = ShownPixels.of(pixels), unknowns.exposure
    with torch.no_grad():
        points = pixels.points.bent(bent(pixels.points.normal, values.tilt))
        alpha = values.alpha.clamp(ALPHA_LOW, 1)
        lobes = transport.lobes(points, alpha, options.texture_samples, None, options.seed)
        gathering = [LinearMap.from_rows(lobes.columns, lobes.spread(w), lobes.sources) for w in lobes.weights(alpha)]
    light = unknowns.light.detach().clone().requires_grad_()
    adam = torch.optim.Adam([light], RATE, betas=(0.9, 0.99))
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(adam, STEPS)
    for _ in range(STEPS):
        radiance = replace(unknowns, light=light).radiance
        sources, irradiance = transport.sources(radiance, unknowns.diffuse_albedo, lit.spec.bounces)
        vectors = transport.vector_irradiance(radiance)
        arriving = irradiance_at(transport, points, pixels.points.normal, irradiance, vectors)
        gathered = gathering[0] @ sources, gathering[1] @ sources
        gain, lobe = gain_and_lobe(lit.model, values.specular, alpha, arriving, lobes, gathered)
        fit = values.albedo * gain + lobe
        difference = residual(shown, fit if exposure is None else fit * exposure[shown.view][:, None])
        loss = torch.nn.functional.huber_loss(difference, torch.zeros_like(difference), delta=HUBER)
        adam.zero_grad()
        (loss + light_energy(light, options.light_smoothness, options.light_whiteness)).backward()
        if not bool(torch.isfinite(light.grad).all()):  # type: ignore[arg-type]
            warnings.warn(
                "the light stays as it was fitted at vertices, for under the texels' lobes its gradient is not finite; "
                "look for broken pixels or triangles with: hir check",
                stacklevel=2,
            )
            return lit
        adam.step()
        schedule.step()
    return lit.under(replace(unknowns, light=light.detach()))
