"""Initial values of a fit: from the photographs, or from the fit of another model."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import Material
from hir_plugins.reflectance_renderers.transport_ggx.fit.final_albedo import ALBEDO_HIGH, ALBEDO_LOW
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.observed_pixels import ObservedPixels
from hir_plugins.reflectance_renderers.transport_ggx.fit.gradient_grid import GradientGrid
from hir_plugins.reflectance_renderers.transport_ggx.fit.initial.initial_metalness import (
    with_metalness,
    without_metalness,
)
from hir_plugins.reflectance_renderers.transport_ggx.fit.initial.measured_scale import with_brighter_light
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters, logit_of_alpha
from hir_plugins.reflectance_renderers.transport_ggx.operator.camera_light import irradiance_of
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport

MIN_INITIAL_ALBEDO, MAX_INITIAL_ALBEDO = 0.02, 0.95
METAL_REFLECTANCE = 0.9
"""Of a metal in its brightest channel at first. Iron and chrome have 0.56, aluminium 0.92, silver, copper and gold 0.95
to 1 (Lagarde 2011)."""
MEAN_WEIGHT = 0.05
"""Weight of the mean albedo at a vertex, as a fraction of the mean weight of a vertex's pixels."""
INDIRECT_ITERATIONS = 4
"""Iterations of darker albedos and the indirect light that they cause; each reduces the change by the albedo."""
MIN_INITIAL_SPECULAR_LOGIT = math.log(0.03 / 0.97)
"""Lower limit of logit ρs where a colour or a map starts: near ρs = 0 the logistic function has no slope."""
BRIGHTER_LIGHTS = (3.0, 9.0)
"""Factors of the light that are tried where the lobe of a dielectric is new. A mean albedo of 0.3 becomes 0.1 and
0.033; rubber and black plastic have 0.02 to 0.05 (docs/studies/initial_guess.md)."""
MOSTLY_METAL = 0.75
"""The second initial metalness that is tried: a narrow lobe with much diffuse light is a minimum of the loss too."""


def initial_albedo(
    transport: Transport,
    observed: ObservedPixels,
    arriving: Float[Tensor, "P 3"],
    uniform: bool,
    grid: GradientGrid | None = None,
) -> Float[Tensor, "V 3"]:
    """Mean colour over mean irradiance, or that of each vertex, near the mean where few pixels see it. With the `grid`
    of the fit, whose gradients do not change what varies inside a cell, vertices of a cell share their pixels.

    If the light is unknown, the albedo should be `uniform`: gradient steps do not remove shading from an initial
    albedo. `arriving` is the irradiance of the pixels.
    """
    count = len(transport.surface.positions)
    if len(observed) == 0:
        return torch.full((count, 3), 0.5, device=arriving.device)
    mean = _mean_albedo(observed, arriving)
    if uniform:
        return mean.clamp(MIN_INITIAL_ALBEDO, MAX_INITIAL_ALBEDO).expand(count, 3).contiguous()
    vertices = transport.interpolation(observed.points)[0]
    color = vertices.transposed @ observed.color
    white = vertices.transposed @ (arriving / torch.pi)
    if grid is not None:
        color, white = grid.smoothed(color), grid.smoothed(white)
    weight = MEAN_WEIGHT * white.mean()
    albedo = (color + weight * mean) / (white + weight).clamp_min(1e-9)
    return albedo.clamp(MIN_INITIAL_ALBEDO, MAX_INITIAL_ALBEDO)


def initial_metal(
    transport: Transport, observed: ObservedPixels, arriving: Float[Tensor, "P 3"], is_measured: bool = False
) -> tuple[Float[Tensor, ""], Float[Tensor, "V 3"]]:
    """Factor of the light and one base colour of a metal, with the mean colour of the photographs and the brightness of
    metals.

    The product of both is what photographs show. The base colour is the one that is known to be bright, and what metal
    reflects in metal depends on it. If the brightness of the light `is_measured` the base colour is as bright as it is.
    `arriving` is the irradiance of the pixels.
    """
    count = len(transport.surface.positions)
    if len(observed) == 0:
        return arriving.new_ones(()), torch.full((count, 3), METAL_REFLECTANCE, device=arriving.device)
    mean = _mean_albedo(observed, arriving)
    gain = torch.ones_like(mean.max()) if is_measured else (mean.max() / METAL_REFLECTANCE).clamp_min(1e-6)
    base = (mean / gain).clamp(MIN_INITIAL_ALBEDO, MAX_INITIAL_ALBEDO)
    return gain, base.expand(count, 3).contiguous()


def direct_irradiance(
    transport: Transport,
    observed: ObservedPixels,
    light: Float[Tensor, "H W 3"],
    rotation: Float[Tensor, "N 3 3"] | None,
    samples: int,
) -> Float[Tensor, "P 3"]:
    """Irradiance of pixels by a distant light, without indirect light.

    `rotation` and `samples` are those of a light that moves with the camera.
    """
    black = torch.zeros(len(transport.surface.positions), 3, device=light.device)
    sources, irradiance = transport.sources(light, black, 0)
    if rotation is not None:
        return irradiance_of(transport, observed.points, samples, rotation, sources)
    return transport.interpolation(observed.points)[1] @ irradiance


def _mean_albedo(observed: ObservedPixels, arriving: Float[Tensor, "P 3"]) -> Float[Tensor, " 3"]:
    return observed.color.mean(dim=0) / (arriving / torch.pi).mean(dim=0).clamp_min(1e-6)


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
            # of several lights the mean: one albedo is seen under all
            received = [each.reshape(transport.takes.count, -1, 3).mean(dim=0) for each in (direct, irradiance)]
            share = received[0] / received[1].clamp_min(1e-12)
            share = torch.where(received[1] > 0, share, torch.ones_like(share))
            share = share[transport.irradiance_cache.of_vertex]
            if base.metalness is not None:
                share = share + base.metal_share * (1 - share)
            albedo = original * share
        return torch.logit(albedo.clamp(ALBEDO_LOW, ALBEDO_HIGH))


def simpler_model(spec: ModelSpec) -> ModelSpec | None:
    """The model that is fitted first where there is no earlier fit."""
    if spec.metalness == "map":
        return ModelSpec(
            "metallic",
            "uniform",
            bounces=spec.bounces,
            light_frame=spec.light_frame,
            light_is_known=spec.light_is_known,
            exposures=spec.exposures,
            metalness="metal",
            lamp=spec.lamp,
        )
    if spec.brdf in ("diffuse", "metallic"):
        return None
    return ModelSpec(
        "diffuse",
        bounces=spec.bounces,
        light_frame=spec.light_frame,
        light_is_known=spec.light_is_known,
        exposures=spec.exposures,
        lamp=spec.lamp,
    )


def extended_to(spec: ModelSpec, base: Parameters, material: Material) -> Parameters:
    """The values of `base` with those that a model needs and `base` lacks: lobes and metalness of the material."""
    f0 = material.specular_albedo.mean()
    if material.metalness is not None:
        f0 = f0.new_tensor(material.dielectric_f0)
    initial_f0 = torch.logit(f0.clamp(1e-3, 0.999)).reshape(1, 1)
    if spec.brdf == "metallic":
        base = with_metalness(base, initial_f0, spec.metalness == "metal")
    else:
        base = without_metalness(base)
    normal_offset = base.normal_offset
    if spec.normals == "map" and normal_offset is None:
        normal_offset = base.diffuse.new_zeros(base.diffuse.shape)
    if spec.brdf == "diffuse":
        return Parameters(
            base.light,
            base.diffuse,
            None,
            None,
            base.log_exposure,
            normal_offset=normal_offset,
            exposure_take=base.exposure_take,
            lamp=base.lamp,
        )
    specular, width = base.specular, base.width
    vertices = len(base.diffuse)
    if specular is None or width is None:
        alpha = material.roughness.mean().clamp(0.02, 0.98)
        specular, width = initial_f0, logit_of_alpha(alpha).reshape(1, 1)
    if spec.colored and specular.shape[1] == 1:
        specular = specular.clamp_min(MIN_INITIAL_SPECULAR_LOGIT).expand(-1, 3)
    if spec.specular == "map" and len(specular) == 1:
        specular = specular.clamp_min(MIN_INITIAL_SPECULAR_LOGIT).expand(vertices, -1)
    if spec.roughness == "map" and len(width) == 1:
        width = width.expand(vertices, -1)
    return Parameters(
        base.light,
        base.diffuse,
        specular.contiguous(),
        width.contiguous(),
        base.log_exposure,
        normal_offset=normal_offset,
        metalness=base.metalness,
        exposure_take=base.exposure_take,
        lamp=base.lamp,
    )


def initial_candidates(
    spec: ModelSpec, parameters: Parameters, earlier: Parameters | None, scale_is_known: bool
) -> list[Parameters]:
    """The initial values, and others from which a fit may find a lower minimum.

    Where a metalness is new: mostly metal. Where the lobe of a dielectric is new: darker albedos under a brighter
    light. A diffuse fit says nothing about that scale, but highlights do: F0 is about 0.04 for most dielectrics.
    """
    if earlier is None:
        return [parameters]
    if spec.brdf == "dielectric" and earlier.width is None and not scale_is_known:
        gains = (parameters.light.new_full((3,), gain) for gain in BRIGHTER_LIGHTS)
        return [parameters, *(with_brighter_light(parameters, gain) for gain in gains)]
    if parameters.metalness is None or earlier.metalness is not None or parameters.is_metal:
        return [parameters]
    return [parameters, replace(parameters, metalness=torch.logit(torch.full_like(parameters.metalness, MOSTLY_METAL)))]
