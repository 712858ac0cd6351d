"""From a fit at vertices to the textures of a material."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from hir_core.capture import Capture
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import Material, Mesh, Scene, Topology
from hir_core.scene.srgb import srgb_slope
from hir_core.stages.atlas import TexelSurface, dilate, fill_unobserved, texel_surface, texture_of_vertices
from hir_plugins.reflectance_renderers.transport_ggx.fit.observed_pixels import Photographed, photographed
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Unknowns
from hir_plugins.reflectance_renderers.transport_ggx.fit.shading_normals import bent
from hir_plugins.reflectance_renderers.transport_ggx.operator.camera_light import pixel_irradiance
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import Surface
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.textures.normal_map import normal_map
from hir_plugins.reflectance_renderers.transport_ggx.textures.texel_equations import (
    FEWEST_PIXELS,
    LEAST_INFORMATION,
    TexelEquations,
    bilinear_texels,
    solve_texels,
)
from hir_plugins.reflectance_renderers.transport_ggx.textures.texture_shading import (
    gain_and_lobe,
    irradiance_at,
    received,
)

PADDING = 8
"""Rings of texels around charts that repeat their border, for filtering and mip maps."""
HUBER_SRGB = 0.05
PRIOR = 0.01
"""Hold on the vertex solution; without any, texels that few pixels see learn their noise."""
SMOOTH = 0.02
"""Weight of differences between neighbouring texels: keeps apart what pixels tell from what they leave open."""
KNOWN = 0.99
"""Share of a texel's vertices that photographs tell of."""
DARKEST = 0.003
"""Linear value below which the sRGB weight stops growing: noise rules there."""


def solve_scene(
    transport: Transport,
    scene: Scene,
    capture: Capture,
    views: Sequence[int],
    downsample: int,
    spec: ModelSpec,
    unknowns: Unknowns,
    rotation: Tensor | None,
    options: TransportGGXOptions,
    report: Callable[[float], None],
) -> tuple[Material, list[TexelEquations], dict[str, Any]]:
    """The material of a fit, and what its albedo was solved from; maps that the rung does not vary are constants."""
    assert scene.material is not None
    height, width = texture_size(scene.material)
    mesh = refined_mesh(transport.surface)
    surface = texel_surface(mesh, (height, width))
    with torch.no_grad():
        sources, irradiance = _light(transport, unknowns, spec, rotation)
        vectors = None if unknowns.tilt is None else transport.vector_irradiance(unknowns.radiance)
        equations = []
        told = unknowns.light.new_zeros(len(transport.surface.positions), 2)
        most = max(64, options.texture_pixels // max(len(views), 1))
        for done, view in enumerate(views):
            part = photographed(transport, capture, view, most, downsample, options.seed + 1)
            found = _equations(
                transport, part, unknowns, spec, sources, irradiance, vectors, rotation, options, (height, width)
            )
            told += _told(transport, part, found)
            equations += found
            report(0.8 * (done + 1) / len(views))
        start = texture_of_vertices(mesh, unknowns.diffuse_albedo, surface)
        start = dilate(start, surface.covered, PADDING)
        diffuse, seen = solve_texels(equations, start, HUBER_SRGB, PRIOR, SMOOTH)
        # between the pixels of a texture that is finer than the photographs stands what its vertices have of them
        known = texture_of_vertices(mesh, _informed(told)[:, None].float(), surface)[..., 0] > KNOWN
        observed = (seen | known) & surface.covered
        report(0.9)

        def finished(texture: Float[Tensor, "H W C"]) -> Float[Tensor, "H W C"]:
            return dilate(fill_unobserved(texture, mesh, observed, surface), surface.covered, PADDING)

        material = Material(
            model="paper" if spec.brdf == "paper" else "dielectric",
            diffuse_albedo=finished(diffuse),
            specular_albedo=_map(mesh, surface, _rgb(unknowns.specular_albedo), finished)
            if spec.brdf != "diffuse"
            else diffuse.new_zeros(3),
            roughness=_map(mesh, surface, unknowns.alpha, finished) if spec.brdf != "diffuse" else diffuse.new_ones(1),
            normal=None
            if unknowns.tilt is None
            else normal_map(scene.mesh, finished(texture_of_vertices(mesh, unknowns.tilt, surface)), PADDING),
            observed=observed,
        )
        if spec.brdf == "diffuse":
            # ρs = 0 is Lambert's law in the paper's model; `dielectric` would keep its grazing reflection
            material = Material(
                "paper",
                material.diffuse_albedo,
                material.specular_albedo,
                material.roughness,
                material.normal,
                observed,
            )
        report(1.0)
    shown = int(observed.sum()) / max(int(surface.covered.sum()), 1)
    facts: dict[str, Any] = {"texture_equations": sum(len(e.gain) for e in equations), "observed": round(shown, 4)}
    if unknowns.exposure is not None:
        facts["view_gain"] = [round(float(e), 4) for e in unknowns.exposure]
    return material, equations, facts


def _equations(
    transport: Transport,
    part: Photographed,
    unknowns: Unknowns,
    spec: ModelSpec,
    sources: Tensor,
    irradiance: Tensor,
    vectors: Tensor | None,
    rotation: Tensor | None,
    options: TransportGGXOptions,
    size: tuple[int, int],
) -> list[TexelEquations]:
    if len(part) == 0:
        return []
    points = part.points
    corners = transport.surface.faces[points.face]

    def at_points(values: Tensor) -> Tensor:
        return values if len(values) == 1 else (values[corners] * points.barycentric[..., None]).sum(1)

    if unknowns.tilt is not None:
        points = points.bent(bent(points.normal, at_points(unknowns.tilt)))
    if rotation is None:
        arriving = irradiance_at(transport, points, part.points.normal, irradiance, vectors)
    else:
        arriving = pixel_irradiance(transport, points, options.diffuse_samples, rotation, options.seed).matrix @ sources
    if spec.brdf == "diffuse":
        gain, specular = arriving / torch.pi, torch.zeros_like(arriving)
    else:
        rho_s, alpha = at_points(unknowns.specular_albedo), at_points(unknowns.alpha)
        lobes = transport.lobes(points, alpha, options.texture_samples, rotation, options.seed)
        gathered = received(lobes, alpha, sources)
        gain, specular = gain_and_lobe(spec.brdf, rho_s, alpha, arriving, lobes, gathered)
    return [texel_equations(transport, part, gain, specular, unknowns.exposure, size)]


def texel_equations(
    transport: Transport,
    part: Photographed,
    gain: Float[Tensor, "P 3"],
    lobe: Float[Tensor, "P 3"],
    exposure: Float[Tensor, " views"] | None,
    size: tuple[int, int],
) -> TexelEquations:
    """What pixels say of a texture of height and width `size`, once their gain and their lobe are known."""
    index, bilinear = bilinear_texels(part.points.uvs(transport.surface), *size)
    importance = srgb_slope(part.color.clamp(DARKEST, 1)).square()
    color = part.color if exposure is None else part.color / exposure[part.points.view][:, None]
    return TexelEquations(index, bilinear, gain, color, lobe, importance, part.saturated, part.pixel)


def _told(transport: Transport, part: Photographed, equations: list[TexelEquations]) -> Float[Tensor, "V 2"]:
    """Pixels that look at each vertex, and the light by which they see it, squared; a clipped one does not tell."""
    if not equations:
        return part.color.new_zeros(len(transport.surface.positions), 2)
    vertices, _ = transport.interpolation(part.points)
    light = (equations[0].gain.square() * ~equations[0].at_least).mean(dim=1)
    return vertices.transposed @ torch.stack([torch.ones_like(light), light], dim=1)


def _informed(told: Float[Tensor, "V 2"]) -> Bool[Tensor, " V"]:
    """Vertices that are seen, and by as much light as a texel must have to count as observed."""
    seen, light = told.unbind(1)
    known = seen > FEWEST_PIXELS
    mean = light[known].mean() if bool(known.any()) else light.new_ones(())
    return known & (light > LEAST_INFORMATION * PRIOR * mean)


def _light(transport: Transport, unknowns: Unknowns, spec: ModelSpec, rotation: Tensor | None) -> tuple[Tensor, Tensor]:
    if rotation is not None:
        return transport.sky_only(unknowns.radiance), unknowns.radiance.new_zeros(0, 3)
    return transport.sources(unknowns.radiance, unknowns.diffuse_albedo, spec.bounces)


def _map(
    mesh: Mesh, surface: TexelSurface, values: Float[Tensor, "#V C"], finished: Callable[[Tensor], Tensor]
) -> Tensor:
    if len(values) == 1:
        return values[0].clone()
    return finished(texture_of_vertices(mesh, values, surface))


def _rgb(values: Float[Tensor, "#V C"]) -> Float[Tensor, "#V 3"]:
    return values.expand(-1, 3)


def refined_mesh(surface: Surface) -> Mesh:
    """The surface with texture coordinates by corner."""
    assert surface.corner_uvs is not None
    corners = torch.arange(3 * len(surface.faces), device=surface.faces.device).reshape(-1, 3)
    return Mesh(surface.positions, Topology(surface.faces, corners), surface.corner_uvs.reshape(-1, 2))


def texture_size(material: Material) -> tuple[int, int]:
    """Height and width of the albedo's texture."""
    texture = material.diffuse_albedo
    return (int(texture.shape[0]), int(texture.shape[1])) if texture.ndim == 3 else (1024, 1024)
