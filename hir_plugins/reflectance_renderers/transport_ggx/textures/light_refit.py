"""The light fitted again for per-texel BRDFs: the fit at vertices saw it through one lobe for the whole surface."""

from __future__ import annotations

import warnings
from dataclasses import replace

import torch
from torch import Tensor

from hir_core.optimization.linear_maps import LinearMap
from hir_core.optimization.optimization_loop import optimize
from hir_core.optimization.schedules import Schedule
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.observed_pixels import ObservedPixels
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.pixel_batches import PixelColors, srgb_residual
from hir_plugins.reflectance_renderers.transport_ggx.fit.joint_optimization import ADAM_BETAS
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import MIN_ALPHA
from hir_plugins.reflectance_renderers.transport_ggx.fit.smoothness import light_energy
from hir_plugins.reflectance_renderers.transport_ggx.operator.shading_normals import offset_normals
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.textures.brdf_fit_state import PointBrdfs
from hir_plugins.reflectance_renderers.transport_ggx.textures.per_texel_brdf import LitSurface
from hir_plugins.reflectance_renderers.transport_ggx.textures.texture_shading import gain_and_lobe, irradiance_at

STEPS, LEARNING_RATE = 80, 0.04
"""Of Adam; only the light changes, and it starts near its optimum."""
LIGHT_HUBER_SRGB = 0.1
"""Residual in sRGB from which the loss is linear."""
MAX_LIGHT_PIXELS = 120_000
"""Pixels whose lobes are in memory, some 1 kB each."""


def light_pixels(pixels: ObservedPixels, seed: int, most: int = MAX_LIGHT_PIXELS) -> ObservedPixels:
    """A random subset of at most so many pixels."""
    if len(pixels) <= most:
        return pixels
    return pixels.take(torch.randperm(len(pixels), generator=torch.Generator().manual_seed(seed))[:most])


def refit_light(
    lit: LitSurface, pixels: ObservedPixels, values: PointBrdfs, options: TransportGGXOptions
) -> LitSurface:
    """The surface under the light for which pixels with the BRDFs `values` are nearest to their photographs."""
    transport, parameters = lit.transport, lit.parameters
    colors, exposure, takes = PixelColors.of(pixels), parameters.exposure, transport.takes.count
    with torch.no_grad():
        points = pixels.points.with_normals(offset_normals(pixels.points.normal, values.normal_offset))
        alpha = values.alpha.clamp(MIN_ALPHA, 1)
        lobes = transport.lobes(points, alpha, options.texture_samples, None, options.seed)
        lobe_maps = [
            LinearMap.from_rows(lobes.columns, lobes.matrix_entries(w), lobes.sources) for w in lobes.weights(alpha)
        ]
    light = parameters.light.detach().clone().requires_grad_()

    def loss(_: int) -> dict[str, Tensor]:
        radiance = replace(parameters, light=light).radiance
        sources, irradiance = transport.sources(radiance, parameters.base_color, lit.spec.bounces)
        vectors = transport.vector_irradiance(radiance)
        arriving = irradiance_at(transport, points, pixels.points.normal, irradiance, vectors)
        received = lobe_maps[0] @ sources, lobe_maps[1] @ sources
        gain, lobe = gain_and_lobe(lit.model, values.specular, alpha, arriving, lobes, received)
        fit = values.albedo * gain + lobe
        difference = srgb_residual(colors, fit if exposure is None else fit * exposure[colors.view])
        zero = torch.zeros_like(difference)
        return {
            "pixels": torch.nn.functional.huber_loss(difference, zero, delta=LIGHT_HUBER_SRGB),
            "light": light_energy(light, options.light_smoothness, options.light_whiteness, takes),
        }

    adam = torch.optim.Adam([light], LEARNING_RATE, betas=ADAM_BETAS)
    result = optimize(loss, adam, Schedule(STEPS, end=0.0), stage="reflectance, light refit", stop_at_nonfinite=True)
    if result.skipped:
        warnings.warn(
            "the light of the fit at vertices is used, because for the per-texel BRDFs its gradient is not finite; "
            "look for broken pixels or triangles with: hir check",
            stacklevel=2,
        )
        return lit
    return lit.with_parameters(replace(parameters, light=light.detach()))
