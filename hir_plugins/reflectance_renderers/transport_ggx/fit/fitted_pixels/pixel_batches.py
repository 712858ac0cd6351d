"""A batch of pixels with the linear maps that predict their radiance: for gradient steps, errors and closed forms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from hir_core.optimization.clipped_pixels import without_clipped_excess
from hir_core.optimization.linear_maps import LinearMap
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene.srgb import linear_to_srgb
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.observed_pixels import ObservedPixels
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from hir_plugins.reflectance_renderers.transport_ggx.operator.camera_lamp import (
    LampPoints,
    LampRays,
    lamp_irradiance,
    lamp_lobe,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.metal_reflections import MetalSurface
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.specular_lobes import Lobes
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.specular_radiance import SpecularMatrices
from hir_plugins.reflectance_renderers.transport_ggx.operator.shading_normals import (
    offset_normals,
    shading_normal_irradiance,
)


@dataclass(frozen=True, eq=False)
class PixelColors:
    """The photographs' colours of some pixels."""

    color_srgb: Float[Tensor, "P 3"]
    saturated: Bool[Tensor, "P 3"]
    """Clipped channels."""
    view: Int[Tensor, " P"]
    view_cosine: Float[Tensor, " P"]
    """Cosine between the normal of the mesh and the direction to the camera."""

    @classmethod
    def of(cls, observed: ObservedPixels) -> PixelColors:
        """The colours of observed pixels."""
        points = observed.points
        return PixelColors(linear_to_srgb(observed.color), observed.saturated, points.view, points.view_cosine)

    @classmethod
    def concatenated(cls, parts: Sequence[PixelColors]) -> PixelColors:
        """The pixels of several batches in one."""
        names = PixelColors.__dataclass_fields__
        return PixelColors(*(torch.cat([getattr(part, name) for part in parts]) for name in names))


@dataclass(frozen=True, eq=False)
class PixelBatch(PixelColors):
    """A batch of pixels with the linear maps that predict their radiance."""

    lobes: Lobes | None
    """None for a diffuse model."""
    vertices: LinearMap
    """Interpolates vertex values at the pixels."""
    cache_cells: LinearMap | None
    """Interpolates the irradiance cache at the pixels; None where the light moves with the camera."""
    direct: LinearMap | None
    """Irradiance of each pixel from the light pyramid, where the light moves with the camera."""
    normal: Float[Tensor, "P 3"]
    """Normal of the mesh, without the normal offset."""
    lamp: LampPoints | None = None
    """The pixels' points before the lamp near the camera; None for models without one."""


def predict(
    transport: Transport, batch: PixelBatch, specular: SpecularMatrices | None, parameters: Parameters, bounces: int
) -> Float[Tensor, "P 3"]:
    """Linear radiance of the pixels of a batch."""
    gain, lobe = diffuse_and_specular(transport, batch, specular, parameters, bounces)
    if lobe is not None and parameters.is_metal:
        return lobe
    diffuse = (batch.vertices @ parameters.diffuse_albedo) * gain
    return diffuse if lobe is None else diffuse + lobe


def diffuse_and_specular(
    transport: Transport, batch: PixelBatch, specular: SpecularMatrices | None, parameters: Parameters, bounces: int
) -> tuple[Float[Tensor, "P 3"], Float[Tensor, "P 3"] | None]:
    """Radiance of a diffuse albedo of 1, and the specular radiance; None for a diffuse model.

    A metal has no diffuse albedo, so its gain is 0 and the irradiance of its pixels is not computed.
    """
    rays = rays_of_lamp(batch, parameters)
    if specular is None or parameters.specular is None:
        return arriving_light(transport, batch, parameters, bounces, rays)[1], None
    if parameters.is_metal:
        sources = light_sources(transport, batch, parameters, bounces)[0]
        gain = sources.new_zeros(len(batch.color_srgb), 3)
    else:
        sources, gain = arriving_light(transport, batch, parameters, bounces, rays)
    rho_s = at_pixels(batch, parameters.specular_albedo)
    alpha = at_pixels(batch, parameters.alpha)
    normal = normals_in_lobe_frame(batch, parameters.normal_offset)
    lobe = specular.radiance(sources, rho_s, alpha, normal)
    if rays is not None:
        white, grazing = lamp_lobe(rays, alpha)
        lobe = lobe + (rho_s * white if specular.model == "paper" else rho_s * (white - grazing) + grazing)
    return gain * specular.diffuse_share(rho_s), lobe


def arriving_light(
    transport: Transport, batch: PixelBatch, parameters: Parameters, bounces: int, rays: LampRays | None
) -> tuple[Float[Tensor, "S 3"], Float[Tensor, "P 3"]]:
    """Radiance of all that a ray can hit, and irradiance / π at the pixels; `rays` as `rays_of_lamp` returns them."""
    sources, irradiance = light_sources(transport, batch, parameters, bounces)
    if batch.direct is not None:
        arriving = batch.direct @ sources
    else:
        assert batch.cache_cells is not None and irradiance is not None
        arriving = batch.cache_cells @ irradiance
        if parameters.normal_offset is not None:
            shading_normal = normals_of_batch(batch, parameters.normal_offset)
            vectors = batch.cache_cells @ transport.vector_irradiance(parameters.radiance).reshape(-1, 9)
            arriving = shading_normal_irradiance(batch.normal, shading_normal, arriving, vectors.reshape(-1, 3, 3))
    if rays is not None:
        arriving = arriving + lamp_irradiance(rays)
    return sources, arriving / torch.pi


def rays_of_lamp(batch: PixelBatch, parameters: Parameters) -> LampRays | None:
    """From the points of a batch, with their shading normals, to the lamp; None without a lamp."""
    lamp = parameters.camera_lamp
    if lamp is None:
        return None
    assert batch.lamp is not None, "the batches of a model with a lamp have points before it"
    points = batch.lamp
    if parameters.normal_offset is not None:
        points = points.with_normals(normals_of_batch(batch, parameters.normal_offset))
    return points.rays(lamp)


def albedo_gain(
    batch: PixelBatch, specular: SpecularMatrices, parameters: Parameters, sources: Float[Tensor, "S 3"]
) -> Float[Tensor, "P 3"]:
    """Change of the specular radiance with ρs, for the α and the normals of the last refresh."""
    gain = specular.albedo_gain(sources)
    if (rays := rays_of_lamp(batch, parameters)) is not None:
        white, grazing = lamp_lobe(rays, at_pixels(batch, parameters.alpha))
        gain = gain + (white if specular.model == "paper" else white - grazing)
    return gain


def light_sources(
    transport: Transport, batch: PixelBatch, parameters: Parameters, bounces: int
) -> tuple[Float[Tensor, "S 3"], Float[Tensor, "C 3"] | None]:
    """Radiance of all that a ray can hit, and irradiance of the cache cells; None where the light moves with the
    camera."""
    if batch.direct is not None:
        return transport.sky_only(parameters.radiance), None
    metalness = None if parameters.metalness is None else parameters.metal_share
    return transport.sources(parameters.radiance, parameters.base_color, bounces, metalness)


def reflecting_metal(transport: Transport, parameters: Parameters, spec: ModelSpec) -> MetalSurface | None:
    """The metal by which the directions of a model's lobes are reflected; None where there is none, and where the
    light moves with the camera."""
    if parameters.metalness is None or spec.light_frame == "camera":
        return None
    return transport.metal_surface(parameters.base_color, parameters.alpha, parameters.metal_share, spec.bounces)


def with_exposure(batch: PixelBatch, radiance: Float[Tensor, "P 3"], parameters: Parameters) -> Float[Tensor, "P 3"]:
    """The radiance times the exposure of each photograph, if exposures are fitted."""
    exposure = parameters.exposure
    return radiance if exposure is None else radiance * exposure[batch.view]


def at_pixels(batch: PixelBatch, values: Float[Tensor, "#V C"]) -> Float[Tensor, "#P C"]:
    """Vertex values at the pixels of a batch; a uniform value stays one row."""
    return values if len(values) == 1 else batch.vertices @ values


def normals_of_batch(batch: PixelBatch, normal_offset: Float[Tensor, "V 3"]) -> Float[Tensor, "P 3"]:
    """Shading normals of the pixels of a batch."""
    return offset_normals(batch.normal, batch.vertices @ normal_offset)


def normals_in_lobe_frame(batch: PixelBatch, normal_offset: Float[Tensor, "V 3"] | None) -> Float[Tensor, "P 3"] | None:
    """Shading normals in the axes of each pixel's lobe; None for the mesh's normals."""
    if normal_offset is None or batch.lobes is None:
        return None
    return (batch.lobes.axes @ normals_of_batch(batch, normal_offset)[..., None])[..., 0]


def srgb_residual(pixels: PixelColors, radiance: Float[Tensor, "P 3"]) -> Float[Tensor, "P 3"]:
    """Prediction minus photograph in sRGB, one-sided for clipped channels."""
    difference = linear_to_srgb(radiance) - pixels.color_srgb
    return without_clipped_excess(difference, pixels.saturated)


def specular_matrices(batches: Sequence[PixelBatch], model: str) -> list[SpecularMatrices | None]:
    """The specular matrices of each batch; None for a diffuse model."""
    return [None if b.lobes is None or model == "diffuse" else SpecularMatrices(b.lobes, model) for b in batches]  # type: ignore[arg-type]


def refresh_matrices(
    batches: Sequence[PixelBatch], specular: Sequence[SpecularMatrices | None], parameters: Parameters
) -> None:
    """Rebuilds the specular matrices for the current α and shading normals, and the shadows of the lamp."""
    lamp = parameters.camera_lamp
    for batch, matrices in zip(batches, specular, strict=True):
        if lamp is not None and batch.lamp is not None:
            batch.lamp.update_shadows(lamp)
        if matrices is not None:
            with torch.no_grad():
                alpha, rho_s = at_pixels(batch, parameters.alpha), at_pixels(batch, parameters.specular_albedo)
                matrices.refresh(alpha, rho_s, normals_in_lobe_frame(batch, parameters.normal_offset))
