"""Surface points of an asset in four distant views, and the incident light at each from sampled directions.

Points are distributed uniformly over the image (area times n.v), without visibility. Directions are sampled half from
the GGX lobe and half from the cosine, as in `hir_exporters.materials.brdf_slice`. All samples are fixed lattices:
results are reproducible.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import Asset
from hir_exporters.conventions import ALPHA_MIN, direction_to_latlong_uv
from hir_exporters.light.environment_map import latlong_pyramid, resample_latlong, sample_latlong, world_radiance
from hir_exporters.materials import brdf_numpy
from hir_exporters.materials.brdf_slice import BrdfSlice
from hir_exporters.mesh.normal_mapping import mapped_normals, unit
from hir_exporters.mesh.tangent_frames import tangent_frames
from hir_exporters.textures.texture_maps import sample_texels

Array = NDArray[np.float64]

POINTS_PER_VIEW: Final = 256
_LIGHT_ROWS = 64  # a finer light has details that the sampled directions do not resolve
_DIRECTIONS, _LATTICE_STEP = 89, 55  # for each of the two densities: consecutive Fibonacci numbers
_GOLDEN_RATIO = (np.sqrt(5) - 1) / 2


@dataclass(frozen=True)
class SurfacePoints:
    """N surface points with everything that a shading formula needs."""

    uvs: Array
    """(N, 2) texture coordinates in [0, 1)."""
    alpha: Array
    """(N,) GGX width."""
    cos_o: Array
    """(N,) n.v."""
    slices: BrdfSlice
    """(N, 1, 2 * 89): the directions of each point."""
    correlated_lobe: Array
    """(N, 1, 178): the lobe with Smith's height-correlated G (Heitz 2014), which engines use."""
    radiance: Array
    """(N, 178, 3) incident radiance from those directions."""
    normals: Array
    reflected: Array
    """(N, 3) shading normal and mirrored view direction, in world axes."""
    light: list[Array]
    """Mipmap levels of the lat-long light (H, 2H, 3) in world axes."""

    def shade(self, brdf_values: Array) -> Array:
        """Radiance (N, 3) towards the camera for BRDF values (N, 1, 178, 3)."""
        weighted = brdf_values[:, 0] * self.slices.weight[:, 0, :, None]
        return np.asarray((weighted * self.radiance).mean(axis=1))

    def irradiance_over_pi(self) -> Array:
        """(N, 3) radiance of a white diffuse surface."""
        return self.shade(np.full((*self.slices.lobe.shape, 1), 1 / np.pi))

    def lobe_terms(self) -> tuple[Array, Array]:
        """A and B (N, 1) of the correlated lobe's directional albedo F0 A + F90 B."""
        weight, s = self.slices.weight[:, 0], self.slices.schlick[:, 0]
        lobe = self.correlated_lobe[:, 0] * weight
        return (lobe * (1 - s)).mean(axis=1, keepdims=True), (lobe * s).mean(axis=1, keepdims=True)

    def prefiltered(self, toward: Array, alpha: Array) -> Array:
        """Mean radiance (N, 3) over a lobe of width alpha (N,) around `toward` (N, 3) with n = v = r (Karis 2013)."""
        u = (np.arange(_DIRECTIONS) + 0.5) / _DIRECTIONS
        phi = 2 * np.pi * (np.arange(_DIRECTIONS) * _LATTICE_STEP / _DIRECTIONS % 1.0)
        a2 = np.maximum(alpha, ALPHA_MIN)[:, None] ** 2
        cos_l = 2 * (1 - u) / (1 + (a2 - 1) * u) - 1
        sin_l = np.sqrt(np.maximum(1 - cos_l**2, 0))
        local = np.stack([sin_l * np.cos(phi), sin_l * np.sin(phi), cos_l], axis=-1)
        cos_h2 = (1 + cos_l) / 2
        density = a2 / (np.pi * (cos_h2 * (a2 - 1) + 1) ** 2) / 4  # D (n.h) / (4 (v.h)) with v = n
        directions = np.einsum("nij,ndj->ndi", tangent_frames(toward), local)
        incident = _lookup(self.light, directions, 1 / (_DIRECTIONS * density))
        weight = np.maximum(cos_l, 0)[..., None]
        return np.asarray((incident * weight).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-9))


def surface_points(asset: Asset) -> SurfacePoints:
    """`4 * POINTS_PER_VIEW` points of a valid asset under its light, or under a uniform white one where it has none."""
    points = [_points_of_view(asset, view) for view in _view_directions()]
    normals, views, uvs = (np.concatenate([part[i] for part in points]) for i in range(3))
    alpha = np.maximum(sample_texels(asset.material.roughness, False, uvs), ALPHA_MIN)
    light = np.ones((8, 16, 3))
    if asset.environment is not None:
        light = resample_latlong(world_radiance(asset)[0], _LIGHT_ROWS, 2 * _LIGHT_ROWS)
    return _with_incident_light(normals, views, uvs, alpha, light)


def _view_directions() -> Array:
    """Directions (4, 3) towards four cameras around the object, slightly above and below it."""
    azimuth, height = np.arange(4) * np.pi / 2 + 0.4, np.array([0.35, -0.2, 0.5, 0.1])
    horizontal = np.sqrt(1 - height**2)
    return np.stack([horizontal * np.sin(azimuth), height, horizontal * np.cos(azimuth)], axis=-1)


def _points_of_view(asset: Asset, view: Array) -> tuple[Array, Array, Array]:
    """Shading normals, view directions and UVs (N, …) of points that face a camera."""
    mesh = asset.mesh
    a, b, c = mesh.positions[mesh.faces].astype(np.float64).transpose(1, 0, 2)
    facing = np.maximum(np.cross(b - a, c - a) @ view, 0)
    if facing.sum() <= 0:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2))
    steps = (np.arange(POINTS_PER_VIEW) + 0.5) / POINTS_PER_VIEW
    faces = np.searchsorted(np.cumsum(facing) / facing.sum(), steps).clip(0, len(facing) - 1)
    number = np.arange(POINTS_PER_VIEW)
    p, q = np.sqrt((number * _GOLDEN_RATIO) % 1), (number * _GOLDEN_RATIO**2) % 1
    corners = np.stack([1 - p, p * (1 - q), p * q], axis=-1)[..., None]
    chosen = mesh.faces[faces]
    normals = unit((mesh.normals[chosen] * corners).sum(1))
    uvs = (mesh.uvs[chosen].astype(np.float64) * corners).sum(1) % 1.0
    if asset.material.normal is not None:
        normals = mapped_normals(mesh, asset.material.normal, chosen, normals, uvs)
    visible = normals @ view > 0.02
    return normals[visible], np.broadcast_to(view, (int(visible.sum()), 3)), np.minimum(uvs[visible], 1 - 1e-9)


def _with_incident_light(normals: Array, views: Array, uvs: Array, alpha: Array, light: Array) -> SurfacePoints:
    cos_o = (normals * views).sum(-1)
    tangent = unit(views - normals * cos_o[:, None])
    tangent = np.where(np.linalg.norm(tangent, axis=-1, keepdims=True) > 0.5, tangent, tangent_frames(normals)[..., 0])
    frame = np.stack([tangent, np.cross(normals, tangent), normals], axis=-1)
    o, a = cos_o[:, None], alpha[:, None]
    height = (np.arange(_DIRECTIONS) + 0.5) / _DIRECTIONS
    rotation = (np.arange(len(normals)) * _GOLDEN_RATIO)[:, None]  # different for neighbours, to decorrelate errors
    azimuth = 2 * np.pi * ((np.arange(_DIRECTIONS) * _LATTICE_STEP / _DIRECTIONS + rotation) % 1.0)
    local = np.concatenate([_lobe_directions(o, a, height, azimuth), _cosine_directions(height, azimuth)], axis=1)

    wo = np.stack([np.sqrt(np.maximum(1 - o[:, 0] ** 2, 0.0)), 0 * o[:, 0], o[:, 0]], axis=-1)[:, None]
    cos_i, _, cos_h, cos_d = brdf_numpy.half_vector_cosines(local, wo)
    distribution = brdf_numpy.ggx_distribution(cos_h, a)
    masking = 2 / (o + np.sqrt(a * a + (1 - a * a) * o * o))
    density = 0.5 * masking * distribution / 4 + 0.5 * np.maximum(cos_i, 0) / np.pi
    scale, bias = brdf_numpy.albedo_terms(o, a)
    slices = BrdfSlice(
        schlick=brdf_numpy.schlick_weight(cos_d)[:, None],
        lobe=(distribution * brdf_numpy.smith_visibility(cos_i, o, a))[:, None],
        albedo_scale=np.broadcast_to(scale, cos_i.shape)[:, None],
        albedo_bias=np.broadcast_to(bias, cos_i.shape)[:, None],
        weight=np.where(cos_i > 0, cos_i / np.maximum(density, 1e-300), 0.0)[:, None],
    )
    up = np.maximum(cos_i, 0)
    joint = up * np.sqrt(a * a + (1 - a * a) * o * o) + o * np.sqrt(a * a + (1 - a * a) * up * up)
    correlated = np.where(cos_i > 0, distribution * 0.5 / np.maximum(joint, 1e-12), 0.0)
    pyramid = latlong_pyramid(light)
    solid_angle = 1 / (2 * _DIRECTIONS * np.maximum(density, 1e-12))
    incident = _lookup(pyramid, np.einsum("nij,ndj->ndi", frame, local), solid_angle)
    reflected = 2 * cos_o[:, None] * normals - views
    return SurfacePoints(uvs, alpha, cos_o, slices, correlated[:, None], incident, normals, reflected, pyramid)


def _lobe_directions(cos_o: Array, alpha: Array, height: Array, azimuth: Array) -> Array:
    """View directions mirrored at visible half vectors (N, D, 3); the normal is (0, 0, 1), the view in the xz plane."""
    sin_o = np.sqrt(np.maximum(1 - cos_o * cos_o, 0))
    length = np.hypot(alpha * sin_o, cos_o)
    x, z = alpha * sin_o / length, cos_o / length
    cap_z = (1 - height) * (1 + z) - z
    cap_r = np.sqrt(np.maximum(1 - cap_z * cap_z, 0))
    half = unit(np.stack([alpha * (cap_r * np.cos(azimuth) + x), alpha * cap_r * np.sin(azimuth), cap_z + z], -1))
    view = np.stack([sin_o, np.zeros_like(sin_o), cos_o], axis=-1)
    return np.asarray(2 * (half * view).sum(-1, keepdims=True) * half - view)


def _cosine_directions(height: Array, azimuth: Array) -> Array:
    sine = np.sqrt(height)
    up = np.broadcast_to(np.sqrt(1 - height), azimuth.shape)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), up], axis=-1)


def _lookup(pyramid: list[Array], directions: Array, solid_angle: Array) -> Array:
    """Radiance averaged over the solid angle of each direction, so that no small lamp is missed: two mipmap levels."""
    pixel = (np.pi / pyramid[0].shape[0]) ** 2
    level = np.clip(0.5 * np.log2(np.maximum(solid_angle / pixel, 1)), 0, len(pyramid) - 1)
    lower = np.minimum(level.astype(np.int64), len(pyramid) - 2)
    uv, result = direction_to_latlong_uv(directions), np.empty(directions.shape)
    for index in np.unique(lower):
        chosen = lower == index
        weight = (level[chosen] - index)[:, None]
        fine, coarse = (sample_latlong(pyramid[k], uv[chosen]) for k in (index, index + 1))
        result[chosen] = (1 - weight) * fine + weight * coarse
    return result
