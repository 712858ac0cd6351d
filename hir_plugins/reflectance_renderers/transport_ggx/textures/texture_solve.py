"""The textures of a material from a fit at vertices."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeAlias

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from hir_core.capture import Capture
from hir_core.mesh.texel_rasterization import TexelSurface, dilate, texel_surface, texture_of_vertices
from hir_core.mesh.texture_inpainting import fill_unobserved
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import EnvironmentMap, Material, Mesh, Scene
from hir_core.scene.bilinear import texture_texels
from hir_core.scene.srgb import srgb_slope
from hir_plugins.reflectance_renderers.transport_ggx.fit.final_albedo import SRGB_SLOPE_FLOOR_LINEAR
from hir_plugins.reflectance_renderers.transport_ggx.fit.fit_terms import FitTerms, material_at_vertices
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.observed_pixels import (
    ObservedPixels,
    observe_pixels,
)
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.pixel_batches import reflecting_metal
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from hir_plugins.reflectance_renderers.transport_ggx.operator.camera_lamp import (
    LampCameras,
    LampPoints,
    lamp_irradiance,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.camera_light import pixel_irradiance
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.operator.shading_normals import offset_normals
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import refined_mesh
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.textures.metallic_equations import metallic_equations
from hir_plugins.reflectance_renderers.transport_ggx.textures.normal_map import normal_map
from hir_plugins.reflectance_renderers.transport_ggx.textures.texel_equations import (
    MIN_PIXELS,
    TexelEquations,
    solve_texels,
)
from hir_plugins.reflectance_renderers.transport_ggx.textures.texture_shading import (
    gain_and_lobe,
    irradiance_at,
    lobe_radiance,
    with_lamp,
)

PADDING_TEXELS = 8
"""Width of the border around charts that repeats their edge, for filtering and mip maps."""
TEXEL_HUBER_SRGB = 0.05
TEXEL_PRIOR_WEIGHT = 0.01
"""Weight of the albedo at vertices; without it, texels that few pixels see fit their noise."""
TEXEL_SMOOTHNESS_WEIGHT = 0.02
"""Weight of differences between neighbouring texels: regularises where pixels do not separate texels."""
OBSERVED_LIGHT = 1e-4
"""Share of the mean light, as squared gain, from which a vertex counts as observed: a hundredth of the mean brightness.
White is ten of the 255 steps of a photograph there, if it has a linear value of 0.3 in the mean light."""
MIN_OBSERVED_VERTEX_SHARE = 0.99
"""A texel also counts as observed if this share of its vertices is."""

TextureReport: TypeAlias = dict[str, int | float | list[float]]
"""Figures for run.json, by key."""


def solve_scene(
    transport: Transport,
    scene: Scene,
    capture: Capture,
    views: Sequence[int],
    downsample: int,
    spec: ModelSpec,
    parameters: Parameters,
    rotation: Tensor | None,
    cameras: LampCameras,
    options: TransportGGXOptions,
    report: Callable[[float], None],
    terms: FitTerms | None = None,
) -> tuple[Material, list[TexelEquations], TextureReport]:
    """The material of a fit, the equations of its albedo, and a report. What the model does not vary is a constant.

    `terms` have their say in the albedo; the other maps are those of the fit at vertices, which has minimised them.
    """
    assert scene.material is not None
    height, width = texture_size(scene.material)
    mesh = refined_mesh(transport.surface)
    surface = texel_surface(mesh, (height, width))
    with torch.no_grad():
        sources, irradiance = _light(transport, parameters, spec, rotation)
        start = texture_of_vertices(mesh, parameters.base_color, surface)
        start = dilate(start, surface.covered, PADDING_TEXELS)
        metalness = None
        if parameters.metalness is not None:
            metalness = texture_of_vertices(mesh, parameters.metal_share.expand(len(parameters.diffuse), 1), surface)
            metalness = dilate(metalness, surface.covered, PADDING_TEXELS)
        vectors = None if parameters.normal_offset is None else transport.vector_irradiance(parameters.radiance)
        equations = []
        information = parameters.light.new_zeros(len(transport.surface.positions), 2)
        max_pixels = max(64, options.texture_pixels // max(len(views), 1))
        for done, view in enumerate(views):
            part = observe_pixels(transport, capture, view, max_pixels, downsample, options.seed + 1)
            rows = _equations(
                transport,
                part,
                parameters,
                spec,
                sources,
                irradiance,
                vectors,
                rotation,
                cameras,
                options,
                start,
                metalness,
            )
            information += _vertex_information(transport, part, rows, metalness)
            equations += rows
            report(0.8 * (done + 1) / len(views))
        refiner = None
        if terms is not None:
            at_vertices = material_at_vertices(parameters, spec.brdf)
            textured = replace(
                at_vertices,
                diffuse_albedo=_padded(mesh, surface, at_vertices.diffuse_albedo),
                specular_albedo=_padded(mesh, surface, at_vertices.specular_albedo),
                roughness=_padded(mesh, surface, at_vertices.roughness),
                metalness=metalness,
            )
            shown = Scene(
                scene.mesh, textured, EnvironmentMap(transport.lights(parameters.radiance)[0], None, spec.light_frame)
            )
            refiner = terms.of_textures(shown, TEXEL_HUBER_SRGB)
        solved, observed_texels = solve_texels(
            equations, start, TEXEL_HUBER_SRGB, TEXEL_PRIOR_WEIGHT, TEXEL_SMOOTHNESS_WEIGHT, metalness, refiner
        )
        # texels that are smaller than a photograph's pixels are observed through their vertices
        known = (
            texture_of_vertices(mesh, _observed_vertices(information)[:, None].float(), surface)[..., 0]
            > MIN_OBSERVED_VERTEX_SHARE
        )
        observed = (observed_texels | known) & surface.covered
        report(0.9)

        def finished(texture: Float[Tensor, "H W C"]) -> Float[Tensor, "H W C"]:
            return dilate(fill_unobserved(texture, mesh, observed, surface), surface.covered, PADDING_TEXELS)

        texture = finished(solved)
        normal = None
        if parameters.normal_offset is not None:
            offset = finished(texture_of_vertices(mesh, parameters.normal_offset, surface))
            normal = normal_map(scene.mesh, offset, PADDING_TEXELS)
        if spec.brdf == "diffuse":
            # with ρs = 0 the paper's model is Lambertian; `dielectric` would still reflect at grazing angles
            material = Material("paper", texture, solved.new_zeros(3), solved.new_ones(1), normal, observed)
        else:
            roughness = _map(mesh, surface, parameters.alpha, finished)
            if parameters.metalness is None:
                specular = _map(mesh, surface, _rgb(parameters.specular_albedo), finished)
                material = Material(spec.brdf, texture, specular, roughness, normal, observed)
            else:
                metal = _map(mesh, surface, parameters.metal_share, finished)
                f0 = float(parameters.dielectric_f0)
                material = Material.metallic(texture, metal, roughness, normal, observed, f0)
        report(1.0)
    share = int(observed.sum()) / max(int(surface.covered.sum()), 1)
    report_values: TextureReport = {
        "texture_equations": sum(len(e.gain) for e in equations),
        "observed": round(share, 4),
    }
    return material, equations, report_values


def _equations(
    transport: Transport,
    part: ObservedPixels,
    parameters: Parameters,
    spec: ModelSpec,
    sources: Tensor,
    irradiance: Tensor,
    vectors: Tensor | None,
    rotation: Tensor | None,
    cameras: LampCameras,
    options: TransportGGXOptions,
    start: Float[Tensor, "H W 3"],
    metalness: Float[Tensor, "H W 1"] | None,
) -> list[TexelEquations]:
    if len(part) == 0:
        return []
    points = part.points
    corners = transport.surface.faces[points.face]

    def at_points(values: Tensor) -> Tensor:
        return values if len(values) == 1 else (values[corners] * points.barycentric[..., None]).sum(1)

    if parameters.normal_offset is not None:
        points = points.with_normals(offset_normals(points.normal, at_points(parameters.normal_offset)))
    if rotation is None:
        arriving = irradiance_at(transport, points, part.points.normal, irradiance, vectors)
    else:
        arriving = pixel_irradiance(transport, points, options.diffuse_samples, rotation, options.seed).matrix @ sources
    lamp, rays = parameters.camera_lamp, None
    if lamp is not None:
        before_lamp = LampPoints.of(points, cameras, transport.tracer, transport.offset)
        before_lamp.update_shadows(lamp)
        rays = before_lamp.rays(lamp)
        arriving = arriving + lamp_irradiance(rays)
    if spec.brdf == "diffuse":
        gain, specular = arriving / torch.pi, torch.zeros_like(arriving)
    else:
        rho_s, alpha = at_points(parameters.specular_albedo), at_points(parameters.alpha)
        metal = reflecting_metal(transport, parameters, spec)
        lobes = transport.lobes(points, alpha, options.texture_samples, rotation, options.seed, metal)
        received = lobe_radiance(lobes, alpha, sources)
        if rays is not None:
            received = with_lamp(received, rays, alpha)
        gain, specular = gain_and_lobe(spec.brdf, rho_s, alpha, arriving, lobes, received)
    rows = texel_equations(transport, part, gain, specular, parameters.exposure, (start.shape[0], start.shape[1]))
    if metalness is None:
        return [rows]
    f0 = float(parameters.dielectric_f0)
    return [metallic_equations(rows, start, metalness, f0, arriving, lobes, alpha, received)]


def texel_equations(
    transport: Transport,
    part: ObservedPixels,
    gain: Float[Tensor, "P 3"],
    lobe: Float[Tensor, "P 3"],
    exposure: Float[Tensor, "views 3"] | None,
    size: tuple[int, int],
) -> TexelEquations:
    """The equations of a texture of height and width `size`, from pixels with known gain and lobe."""
    index, bilinear = texture_texels(part.points.uvs(transport.surface), *size)
    color = part.color if exposure is None else part.color / exposure[part.points.view]
    importance = srgb_slope(color.clamp(SRGB_SLOPE_FLOOR_LINEAR, 1)).square()
    return TexelEquations(index.int(), bilinear, gain, color, lobe, importance, part.saturated, part.pixel.int())


def _vertex_information(
    transport: Transport, part: ObservedPixels, equations: list[TexelEquations], metalness: Tensor | None
) -> Float[Tensor, "V 2"]:
    """For each vertex: the number of pixels, and the sum of their squared gains where they are not clipped."""
    if not equations:
        return part.color.new_zeros(len(transport.surface.positions), 2)
    vertices, _ = transport.interpolation(part.points)
    rows = equations[0]
    gain = rows.gain
    if metalness is not None:
        gain = rows.radiance(torch.ones_like(metalness).expand(-1, -1, 3), metalness)
    light = (gain.square() * ~rows.clipped).mean(dim=1)
    return vertices.transposed @ torch.stack([torch.ones_like(light), light], dim=1)


def _observed_vertices(information: Float[Tensor, "V 2"]) -> Bool[Tensor, " V"]:
    """Vertices with the number of pixels that a texel needs to count as observed, and with enough light."""
    count, light = information.unbind(1)
    known = count > MIN_PIXELS
    mean = light[known].mean() if bool(known.any()) else light.new_ones(())
    return known & (light > OBSERVED_LIGHT * mean)


def _light(
    transport: Transport, parameters: Parameters, spec: ModelSpec, rotation: Tensor | None
) -> tuple[Tensor, Tensor]:
    if rotation is not None:
        return transport.sky_only(parameters.radiance), parameters.radiance.new_zeros(0, 3)
    metalness = None if parameters.metalness is None else parameters.metal_share
    return transport.sources(parameters.radiance, parameters.base_color, spec.bounces, metalness)


def _map(
    mesh: Mesh, surface: TexelSurface, values: Float[Tensor, "#V C"], finished: Callable[[Tensor], Tensor]
) -> Tensor:
    if len(values) == 1:
        return values[0].clone()
    return finished(texture_of_vertices(mesh, values, surface))


def _padded(mesh: Mesh, surface: TexelSurface, values: Tensor) -> Tensor:
    """Values at vertices as a texture with borders around its charts; a constant stays one."""
    if values.ndim == 1:
        return values
    return dilate(texture_of_vertices(mesh, values, surface), surface.covered, PADDING_TEXELS)


def _rgb(values: Float[Tensor, "#V C"]) -> Float[Tensor, "#V 3"]:
    return values.expand(-1, 3)


def texture_size(material: Material) -> tuple[int, int]:
    """Height and width of the albedo texture."""
    texture = material.diffuse_albedo
    return (int(texture.shape[0]), int(texture.shape[1])) if texture.ndim == 3 else (1024, 1024)
