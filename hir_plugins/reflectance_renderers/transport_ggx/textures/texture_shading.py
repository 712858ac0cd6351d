"""Radiance of arbitrary pixels from textures: the general form of what `fit/` computes with matrices."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from hir_core.capture import Camera
from hir_core.scene import EnvironmentMap, Material, Texture
from hir_core.scene.bilinear import texture_texels
from hir_plugins.reflectance_renderers.brdf_torch import Model, directional_albedo_terms
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import MIN_ALPHA
from hir_plugins.reflectance_renderers.transport_ggx.operator.camera_lamp import (
    LampCameras,
    LampPoints,
    LampRays,
    lamp_irradiance,
    lamp_lobe,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.camera_light import pixel_irradiance
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_pyramid import resized
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.specular_lobes import Lobes
from hir_plugins.reflectance_renderers.transport_ggx.operator.shading_normals import shading_normal_irradiance
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import SurfacePoints, visible_points
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.textures.normal_map import mapped_normals


@dataclass(frozen=True, eq=False)
class Indirect:
    """Light reflected by the surface itself, from a finished fit; constant."""

    irradiance: Float[Tensor, "C 3"]
    """Indirect irradiance of each cache cell."""
    radiance: Float[Tensor, "C 3"]
    """Radiance that leaves each cache cell."""


def shade(
    transport: Transport,
    material: Material,
    environment: EnvironmentMap,
    cameras: Mapping[int, Camera],
    pixels: Int[Tensor, "B 3"],
    options: TransportGGXOptions,
    indirect: Indirect | None = None,
) -> Float[Tensor, "B 3"]:
    """Radiance of pixels (view, x, y), 0 beside the surface; differentiable in material and light."""
    points, visible = visible_points(transport.tracer, transport.surface, cameras, pixels)
    seen = visible.nonzero()[:, 0]
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
    """Radiance of points towards the camera: direct light with occlusion, and `indirect` light."""
    if len(points) == 0:
        return points.position.new_zeros(0, 3) + 0 * environment.radiance.sum()
    rotation = _to_light(environment, cameras, points)
    radiance = resized(environment.radiance.clamp_min(0), transport.pyramid)
    needs_uv = any(t.ndim == 3 for t in (material.diffuse_albedo, material.specular_albedo, material.roughness))
    needs_uv |= material.normal is not None
    uv = points.uvs(transport.surface) if needs_uv else points.position[:, :2]
    diffuse, specular = sample(material.diffuse_albedo, uv), sample(material.specular_albedo, uv)
    alpha = sample(material.roughness, uv).mean(dim=-1, keepdim=True).clamp(MIN_ALPHA, 1)
    mesh_normal = points.normal
    if material.normal is not None:
        points = points.with_normals(mapped_normals(transport.surface, points, sample(material.normal, uv)))
    sources = transport.sky_only(radiance)
    if indirect is not None:
        sources = torch.cat([sources[: transport.pyramid.texels], indirect.radiance])
    if rotation is None:
        sky = transport.diffuse.sky @ transport.pyramid.flatten(radiance)[transport.level]
        if indirect is not None:
            sky = sky + indirect.irradiance
        vectors = None if material.normal is None else transport.vector_irradiance(radiance)
        arriving = irradiance_at(transport, points, mesh_normal, sky, vectors)
    else:
        arriving = pixel_irradiance(transport, points, options.diffuse_samples, rotation, options.seed) @ sources
    lobes = transport.lobes(points, alpha, options.samples, rotation, options.seed)
    received = lobe_radiance(lobes, alpha, sources)
    if environment.lamp is not None:
        before_lamp = LampPoints.of(
            points, LampCameras.of(cameras, points.position.device), transport.tracer, transport.offset
        )
        before_lamp.update_shadows(environment.lamp)
        rays = before_lamp.rays(environment.lamp)
        arriving = arriving + lamp_irradiance(rays)
        received = with_lamp(received, rays, alpha)
    gain, lobe = gain_and_lobe(material.model, specular, alpha, arriving, lobes, received)
    return diffuse * gain + lobe


def irradiance_at(
    transport: Transport,
    points: SurfacePoints,
    mesh_normal: Float[Tensor, "P 3"],
    irradiance: Float[Tensor, "C 3"],
    vectors: Float[Tensor, "C 3 3"] | None,
) -> Float[Tensor, "P 3"]:
    """Irradiance of points from that of the cache cells; with `vectors` (vector irradiance) for shading normals that
    differ from `mesh_normal`.
    """
    cells = transport.cells_at(points)
    arriving = (irradiance[cells] * points.barycentric[..., None]).sum(1)
    if vectors is None:
        return arriving
    point_vectors = (vectors[cells] * points.barycentric[..., None, None]).sum(1)
    return shading_normal_irradiance(mesh_normal, points.normal, arriving, point_vectors)


def lobe_radiance(
    lobes: Lobes, alpha: Float[Tensor, "#P 1"], sources: Float[Tensor, "S 3"]
) -> tuple[Float[Tensor, "P 3"], Float[Tensor, "P 3"]]:
    """Radiance of lobes with ρs = 1 from the light sources, and the same times Schlick's term."""
    weight, grazing = lobes.weights(alpha)
    light = sources[lobes.columns.long()].reshape(*lobes.n_wi.shape, 4, 3)
    light = (light * lobes.bilinear.reshape(*lobes.n_wi.shape, 4, 1)).sum(2)
    return (light * weight[..., None]).sum(1), (light * grazing[..., None]).sum(1)


def with_lamp(
    received: tuple[Float[Tensor, "P 3"], Float[Tensor, "P 3"]],
    rays: LampRays,
    alpha: Float[Tensor, "#P 1"],
) -> tuple[Float[Tensor, "P 3"], Float[Tensor, "P 3"]]:
    """`received`, as `lobe_radiance` returns it, and the same of a lamp near the camera."""
    white, grazing = lamp_lobe(rays, alpha)
    return received[0] + white, received[1] + grazing


def gain_and_lobe(
    model: Model,
    rho_s: Float[Tensor, "#P C"],
    alpha: Float[Tensor, "#P 1"],
    arriving: Float[Tensor, "P 3"],
    lobes: Lobes,
    received: tuple[Float[Tensor, "P 3"], Float[Tensor, "P 3"]],
) -> tuple[Float[Tensor, "P 3"], Float[Tensor, "P 3"]]:
    """Radiance of a diffuse albedo of 1, and the specular radiance; `received` as `lobe_radiance` returns it."""
    gain, (lobe, schlick) = arriving / torch.pi, received
    if model == "paper":
        return gain, rho_s * lobe
    a, b = directional_albedo_terms(lobes.n_wo[:, None], alpha)
    return gain * (1 - rho_s * a - b).clamp_min(0), rho_s * (lobe - schlick) + schlick


def sample(texture: Texture, uv: Float[Tensor, "P 2"]) -> Float[Tensor, "#P C"]:
    """Bilinear lookup of a map; a constant gives one row."""
    if texture.ndim == 1:
        return texture[None]
    height, width, channels = texture.shape
    index, weight = texture_texels(uv, height, width)
    return (texture.reshape(-1, channels)[index] * weight[..., None].to(texture)).sum(1)


def _to_light(
    environment: EnvironmentMap, cameras: Mapping[int, Camera], points: SurfacePoints
) -> Float[Tensor, "N 3 3"] | None:
    """Rotations, for each view, from the world to the axes of the light; None if they are the same."""
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
