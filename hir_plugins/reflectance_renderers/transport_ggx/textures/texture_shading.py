"""Radiance through arbitrary pixels from textures: the general form of what `joint` does in matrices."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from hir_core.capture import Camera
from hir_core.scene import EnvironmentMap, Material, Texture
from hir_plugins.reflectance_renderers.brdf_torch import Model, directional_albedo_terms
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import ALPHA_LOW
from hir_plugins.reflectance_renderers.transport_ggx.fit.shading_normals import bent_irradiance
from hir_plugins.reflectance_renderers.transport_ggx.operator.camera_light import pixel_irradiance
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_pyramid import resized
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.operator.specular_lobes import Lobes
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import SurfacePoints, see
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.textures.normal_map import mapped_normals
from hir_plugins.reflectance_renderers.transport_ggx.textures.texel_equations import bilinear_texels


@dataclass(frozen=True, eq=False)
class Indirect:
    """Light that comes from the surface itself, as a finished fit has it; held fixed."""

    irradiance: Float[Tensor, "C 3"]
    """Of each cell, without what arrives straight from the light."""
    radiance: Float[Tensor, "C 3"]
    """That leaves each cell."""


def shade(
    transport: Transport,
    material: Material,
    environment: EnvironmentMap,
    cameras: Mapping[int, Camera],
    pixels: Int[Tensor, "B 3"],
    options: TransportGGXOptions,
    indirect: Indirect | None = None,
) -> Float[Tensor, "B 3"]:
    """Radiance through pixels (view, x, y), 0 where they miss; differentiable in material and light."""
    points, found = see(transport.tracer, transport.surface, cameras, pixels)
    seen = found.nonzero()[:, 0]
    value = shade_points(transport, material, environment, cameras, points.take(seen), options, indirect)
    return torch.zeros(len(pixels), 3, dtype=value.dtype, device=value.device).index_copy(0, seen, value)


def shade_points(
    transport: Transport,
    material: Material,
    environment: EnvironmentMap,
    cameras: Mapping[int, Camera],
    points: SurfacePoints,
    options: TransportGGXOptions,
    indirect: Indirect | None = None,
) -> Float[Tensor, "P 3"]:
    """Radiance that leaves points towards the eye: direct light with visibility, and what `indirect` adds."""
    if len(points) == 0:
        return points.position.new_zeros(0, 3) + 0 * environment.radiance.sum()
    rotation = _to_light(environment, cameras, points)
    radiance = resized(environment.radiance.clamp_min(0), transport.pyramid)
    needs_uv = any(t.ndim == 3 for t in (material.diffuse_albedo, material.specular_albedo, material.roughness))
    needs_uv |= material.normal is not None
    uv = points.uvs(transport.surface) if needs_uv else points.position[:, :2]
    diffuse, specular = sample(material.diffuse_albedo, uv), sample(material.specular_albedo, uv)
    alpha = sample(material.roughness, uv).mean(dim=-1, keepdim=True).clamp(ALPHA_LOW, 1)
    straight = points.normal
    if material.normal is not None:
        points = points.bent(mapped_normals(transport.surface, points, sample(material.normal, uv)))
    sources = transport.sky_only(radiance)
    if indirect is not None:
        sources = torch.cat([sources[: transport.pyramid.texels], indirect.radiance])
    if rotation is None:
        sky = transport.diffuse.sky @ transport.pyramid.flatten(radiance)[transport.level]
        if indirect is not None:
            sky = sky + indirect.irradiance
        vectors = None if material.normal is None else transport.vector_irradiance(radiance)
        arriving = irradiance_at(transport, points, straight, sky, vectors)
    else:
        arriving = pixel_irradiance(transport, points, options.diffuse_samples, rotation, options.seed) @ sources
    lobes = transport.lobes(points, alpha, options.samples, rotation, options.seed)
    gain, lobe = gain_and_lobe(material.model, specular, alpha, arriving, lobes, received(lobes, alpha, sources))
    return diffuse * gain + lobe


def irradiance_at(
    transport: Transport,
    points: SurfacePoints,
    straight: Float[Tensor, "P 3"],
    irradiance: Float[Tensor, "C 3"],
    vectors: Float[Tensor, "C 3 3"] | None,
) -> Float[Tensor, "P 3"]:
    """Irradiance of points from that of the cells; with `vectors` for normals bent away from the `straight` ones."""
    cells = transport.cells.of_vertex[transport.surface.faces[points.face]]
    arriving = (irradiance[cells] * points.barycentric[..., None]).sum(1)
    if vectors is None:
        return arriving
    around = (vectors[cells] * points.barycentric[..., None, None]).sum(1)
    return bent_irradiance(straight, points.normal, arriving, around)


def received(
    lobes: Lobes, alpha: Float[Tensor, "#P 1"], sources: Float[Tensor, "S 3"]
) -> tuple[Float[Tensor, "P 3"], Float[Tensor, "P 3"]]:
    """What lobes of ρs = 1 gather from the sources of light, and the part of it that Schlick's term takes."""
    weight, grazing = lobes.weights(alpha)
    light = sources[lobes.columns.long()].reshape(*lobes.n_wi.shape, 4, 3)
    light = (light * lobes.bilinear.reshape(*lobes.n_wi.shape, 4, 1)).sum(2)
    return (light * weight[..., None]).sum(1), (light * grazing[..., None]).sum(1)


def gain_and_lobe(
    model: Model,
    rho_s: Float[Tensor, "#P C"],
    alpha: Float[Tensor, "#P 1"],
    arriving: Float[Tensor, "P 3"],
    lobes: Lobes,
    gathered: tuple[Float[Tensor, "P 3"], Float[Tensor, "P 3"]],
) -> tuple[Float[Tensor, "P 3"], Float[Tensor, "P 3"]]:
    """What points show of their diffuse albedo, and the radiance of their lobe."""
    gain, (lobe, schlick) = arriving / torch.pi, gathered
    if model == "paper":
        return gain, rho_s * lobe
    a, b = directional_albedo_terms(lobes.n_wo[:, None], alpha)
    return gain * (1 - rho_s * a - b).clamp_min(0), rho_s * (lobe - schlick) + schlick


def sample(texture: Texture, uv: Float[Tensor, "P 2"]) -> Float[Tensor, "#P C"]:
    """Bilinear lookup of a map; a constant is one row."""
    if texture.ndim == 1:
        return texture[None]
    height, width, channels = texture.shape
    index, weight = bilinear_texels(uv, height, width)
    return (texture.reshape(-1, channels)[index] * weight[..., None].to(texture)).sum(1)


def _to_light(
    environment: EnvironmentMap, cameras: Mapping[int, Camera], points: SurfacePoints
) -> Float[Tensor, "N 3 3"] | None:
    """Rotations, per view, from the world to the map's axes; None where both are the same."""
    device = points.position.device
    to_map = None if environment.to_world is None else environment.to_world.T.to(device)
    if environment.frame == "world":
        if to_map is None or torch.equal(to_map, torch.eye(3, device=device)):
            return None
        return to_map.expand(max(cameras) + 1, 3, 3)
    rotations = torch.zeros(max(cameras) + 1, 3, 3, device=device)
    for view, camera in cameras.items():
        rotations[view] = torch.from_numpy(camera.world_to_camera[:3, :3].copy()).to(rotations)
    return rotations if to_map is None else to_map @ rotations
