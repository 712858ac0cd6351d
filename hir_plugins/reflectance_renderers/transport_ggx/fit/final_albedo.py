"""The last step of a fit: albedos in closed form, for the light and the lobes of the gradient steps.

A few dozen gradient steps from a uniform albedo leave dark areas too bright, because a logistic changes slowly at its
ends. For fixed light and lobes the albedos are a least-squares problem.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import torch

from hir_core.scene.srgb import srgb_slope, srgb_to_linear
from hir_plugins.reflectance_renderers.transport_ggx.fit.closed_form_albedo import (
    AlbedoEquations,
    AlbedoRefiner,
    MetalTerm,
    solve_albedo,
)
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.pixel_batches import (
    PixelBatch,
    albedo_gain,
    arriving_light,
    at_pixels,
    diffuse_and_specular,
    predict,
    rays_of_lamp,
)
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.specular_radiance import SpecularMatrices

VERTEX_HUBER_SRGB = 0.1
VERTEX_PRIOR_WEIGHT = 0.05
"""Weight of the albedo of the gradient steps, as a fraction of the mean weight of a vertex's pixels: few see each."""
SRGB_SLOPE_FLOOR_LINEAR = 0.003
"""The slope of sRGB, a pixel's weight, does not grow below this linear value, where noise dominates."""
ALBEDO_LOW, ALBEDO_HIGH = 1e-3, 0.999
"""Limits of an albedo whose logistic still has a usable slope."""


def solve_final_albedo(
    transport: Transport,
    batches: Iterable[tuple[PixelBatch, SpecularMatrices | None]],
    parameters: Parameters,
    bounces: int,
    refiner: AlbedoRefiner | None = None,
) -> Parameters:
    """`parameters` with `closed_form_diffuse` for the pixels of `batches`, whose matrices fit the parameters."""
    with torch.no_grad():
        rows = [_equations(transport, batch, matrices, parameters, bounces) for batch, matrices in batches]
        albedo, _, _ = solve_albedo(
            rows, parameters.base_color, VERTEX_HUBER_SRGB, VERTEX_PRIOR_WEIGHT, refiner=refiner
        )
        logits = torch.logit(albedo.clamp(ALBEDO_LOW, ALBEDO_HIGH))
    return replace(parameters, closed_form_diffuse=logits)


def _equations(
    transport: Transport, batch: PixelBatch, specular: SpecularMatrices | None, parameters: Parameters, bounces: int
) -> AlbedoEquations:
    color = srgb_to_linear(batch.color_srgb)
    exposure = parameters.exposure
    observed = color if exposure is None else color / exposure[batch.view]
    importance = srgb_slope(observed.clamp(SRGB_SLOPE_FLOOR_LINEAR, 1)).square()
    gain, lobe = diffuse_and_specular(transport, batch, specular, parameters, bounces)
    if parameters.metalness is None or specular is None:
        target = observed if lobe is None else observed - lobe
        return AlbedoEquations(batch.vertices, gain, target, importance, batch.saturated)
    # first order around the fitted base colour: where m is neither 0 nor 1 it acts twice, in ρd and in the energy that
    # the lobe takes from ρd
    sources, arriving = arriving_light(transport, batch, parameters, bounces, rays_of_lamp(batch, parameters))
    base = parameters.base_color
    diffuse = at_pixels(batch, parameters.diffuse_albedo)
    slope = albedo_gain(batch, specular, parameters, sources) - specular.share_change() * arriving * diffuse
    metal = MetalTerm(slope, parameters.metal_share.expand(len(base), 1))
    rows = AlbedoEquations(batch.vertices, gain, torch.zeros_like(gain), importance, batch.saturated, metal)
    constant = predict(transport, batch, specular, parameters, bounces) - rows.radiance(base)
    return replace(rows, target=observed - constant)
