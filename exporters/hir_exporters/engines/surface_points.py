"""Points of an asset's surface as four far cameras see them, and the light that reaches each from fixed directions.

Points are drawn evenly over the picture (area times n.v), without regard to what hides them; directions half from the
GGX lobe, half from the cosine, as in `hir_exporters.materials.brdf_slice`. Everything is a lattice: the same numbers
every time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import Asset, AssetMesh
from hir_exporters.conventions import ALPHA_MIN, direction_to_latlong_uv
from hir_exporters.light.environment_map import latlong_pyramid, resample_latlong, sample_latlong, world_radiance
from hir_exporters.materials import brdf_numpy
from hir_exporters.materials.brdf_slice import BrdfSlice
from hir_exporters.mesh.tangent_frames import tangent_frames
from hir_exporters.textures.texture_maps import sample_texels

Array = NDArray[np.float64]

POINTS_PER_VIEW: Final = 256
_ROWS = 64  # of the light: finer detail is below what the directions resolve
_COUNT, _STEP = 89, 55  # directions from each density: a Fibonacci number and the one before it
_GOLDEN = (np.sqrt(5) - 1) / 2


@dataclass(frozen=True)
class SurfacePoints:
    """N points: all that a shading formula needs."""

    places: Array
    """(N, 2) texture coordinates in [0, 1)."""
    alpha: Array
    """(N,) GGX width."""
    cos_o: Array
    """(N,) n.v."""
    slices: BrdfSlice
    """(N, 1, 2 * 89): the directions of each point."""
    correlated_lobe: Array
    """(N, 1, 178): the lobe with Smith's height-correlated G (Heitz 2014), which engines shade with."""
    radiance: Array
    """(N, 178, 3) of the light from those directions."""
    normals: Array
    reflected: Array
    """(N, 3) shading normal and mirrored view direction, world."""
    light: list[Array]
    """Lat-long (H, 2H, 3) in world axes, then half as large and so on."""

    def shade(self, brdf_values: Array) -> Array:
        """Radiance (N, 3) towards the camera of BRDF values (N, 1, 178, 3)."""
        weighted = brdf_values[:, 0] * self.slices.weight[:, 0, :, None]
        return np.asarray((weighted * self.radiance).mean(axis=1))

    def irradiance_over_pi(self) -> Array:
        """(N, 3): what a white diffuse surface reflects."""
        return self.shade(np.full((*self.slices.lobe.shape, 1), 1 / np.pi))

    def lobe_terms(self) -> tuple[Array, Array]:
        """A and B (N, 1) of the correlated lobe's directional albedo F0 A + F90 B."""
        weight, s = self.slices.weight[:, 0], self.slices.schlick[:, 0]
        lobe = self.correlated_lobe[:, 0] * weight
        return (lobe * (1 - s)).mean(axis=1, keepdims=True), (lobe * s).mean(axis=1, keepdims=True)

    def prefiltered(self, toward: Array, alpha: Array) -> Array:
        """Mean radiance (N, 3) seen by a lobe of width (N,) about `toward` (N, 3) with n = v = r (Karis 2013)."""
        u = (np.arange(_COUNT) + 0.5) / _COUNT
        phi = 2 * np.pi * (np.arange(_COUNT) * _STEP / _COUNT % 1.0)
        a2 = np.maximum(alpha, ALPHA_MIN)[:, None] ** 2
        cos_l = 2 * (1 - u) / (1 + (a2 - 1) * u) - 1
        sin_l = np.sqrt(np.maximum(1 - cos_l**2, 0))
        local = np.stack([sin_l * np.cos(phi), sin_l * np.sin(phi), cos_l], axis=-1)
        cos_h2 = (1 + cos_l) / 2
        density = a2 / (np.pi * (cos_h2 * (a2 - 1) + 1) ** 2) / 4  # D (n.h) / (4 (v.h)) with v = n
        seen = _lookup(self.light, np.einsum("nij,ndj->ndi", tangent_frames(toward), local), 1 / (_COUNT * density))
        weight = np.maximum(cos_l, 0)[..., None]
        return np.asarray((seen * weight).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-9))


def surface_points(asset: Asset) -> SurfacePoints:
    """`4 * POINTS_PER_VIEW` points of a checked asset under its light, or an even one where it has none."""
    sides = [_seen_from(asset, view) for view in _views()]
    normals, views, places = (np.concatenate([side[i] for side in sides]) for i in range(3))
    alpha = np.maximum(sample_texels(asset.material.roughness, False, places), ALPHA_MIN)
    light = np.ones((8, 16, 3))
    if asset.environment is not None:
        light = resample_latlong(world_radiance(asset)[0], _ROWS, 2 * _ROWS)
    return _lit(normals, views, places, alpha, light)


def _views() -> Array:
    """Directions (4, 3) towards four cameras: around the object, from a little above and below."""
    angle, height = np.arange(4) * np.pi / 2 + 0.4, np.array([0.35, -0.2, 0.5, 0.1])
    level = np.sqrt(1 - height**2)
    return np.stack([level * np.sin(angle), height, level * np.cos(angle)], axis=-1)


def _seen_from(asset: Asset, view: Array) -> tuple[Array, Array, Array]:
    """Shading normals, view directions and texture places (N, …) of points that face a camera."""
    mesh = asset.mesh
    a, b, c = mesh.positions[mesh.faces].astype(np.float64).transpose(1, 0, 2)
    facing = np.maximum(np.cross(b - a, c - a) @ view, 0)
    if facing.sum() <= 0:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2))
    steps = (np.arange(POINTS_PER_VIEW) + 0.5) / POINTS_PER_VIEW
    faces = np.searchsorted(np.cumsum(facing) / facing.sum(), steps).clip(0, len(facing) - 1)
    p, q = np.sqrt((np.arange(POINTS_PER_VIEW) * _GOLDEN) % 1), (np.arange(POINTS_PER_VIEW) * _GOLDEN**2) % 1
    corners = np.stack([1 - p, p * (1 - q), p * q], axis=-1)[..., None]
    chosen = mesh.faces[faces]
    normals = _unit((mesh.normals[chosen] * corners).sum(1))
    places = (mesh.uvs[chosen].astype(np.float64) * corners).sum(1) % 1.0
    if asset.material.normal is not None:
        normals = _mapped(asset, mesh, chosen, normals, places)
    keep = normals @ view > 0.02
    return normals[keep], np.broadcast_to(view, (int(keep.sum()), 3)), np.minimum(places[keep], 1 - 1e-9)


def _mapped(asset: Asset, mesh: AssetMesh, chosen: NDArray[np.int32], normals: Array, places: Array) -> Array:
    """Normals turned by the normal map, with each face's own tangent."""
    assert asset.material.normal is not None
    local = sample_texels(asset.material.normal, True, np.minimum(places, 1 - 1e-9))
    p, uv = mesh.positions[chosen].astype(np.float64), mesh.uvs[chosen].astype(np.float64)
    e1, e2, d1, d2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0], uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    area = d1[:, 0] * d2[:, 1] - d2[:, 0] * d1[:, 1]
    tangent = _unit((e1 * d2[:, 1:] - e2 * d1[:, 1:]) * np.sign(area)[:, None])
    tangent = _unit(tangent - normals * (tangent * normals).sum(-1, keepdims=True))
    up = np.cross(normals, tangent) * -np.sign(area)[:, None]  # v grows downwards
    mapped = _unit(local[:, :1] * tangent + local[:, 1:2] * up + local[:, 2:] * normals)
    return np.where((area == 0)[:, None], normals, mapped)


def _lit(normals: Array, views: Array, places: Array, alpha: Array, light: Array) -> SurfacePoints:
    cos_o = (normals * views).sum(-1)
    tangent = _unit(views - normals * cos_o[:, None])
    tangent = np.where(np.linalg.norm(tangent, axis=-1, keepdims=True) > 0.5, tangent, tangent_frames(normals)[..., 0])
    frame = np.stack([tangent, np.cross(normals, tangent), normals], axis=-1)
    o, a = cos_o[:, None], alpha[:, None]
    height = (np.arange(_COUNT) + 0.5) / _COUNT
    turn = (np.arange(len(normals)) * _GOLDEN)[:, None]  # so that neighbours do not share their lattice's gaps
    azimuth = 2 * np.pi * ((np.arange(_COUNT) * _STEP / _COUNT + turn) % 1.0)
    local = np.concatenate([_lobe_directions(o, a, height, azimuth), _cosine_directions(height, azimuth)], axis=1)

    wo = np.stack([np.sqrt(1 - o[:, 0] ** 2), 0 * o[:, 0], o[:, 0]], axis=-1)[:, None]
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
    solid_angle = 1 / (2 * _COUNT * np.maximum(density, 1e-12))
    seen = _lookup(pyramid, np.einsum("nij,ndj->ndi", frame, local), solid_angle)
    reflected = 2 * cos_o[:, None] * normals - views
    return SurfacePoints(places, alpha, cos_o, slices, correlated[:, None], seen, normals, reflected, pyramid)


def _lobe_directions(cos_o: Array, alpha: Array, height: Array, azimuth: Array) -> Array:
    """Mirror directions (N, D, 3) of visible half vectors, about the normal (0, 0, 1) with the view in the xz plane."""
    sin_o = np.sqrt(np.maximum(1 - cos_o * cos_o, 0))
    length = np.hypot(alpha * sin_o, cos_o)
    x, z = alpha * sin_o / length, cos_o / length
    cap_z = (1 - height) * (1 + z) - z
    cap_r = np.sqrt(np.maximum(1 - cap_z * cap_z, 0))
    half = _unit(np.stack([alpha * (cap_r * np.cos(azimuth) + x), alpha * cap_r * np.sin(azimuth), cap_z + z], -1))
    view = np.stack([sin_o, np.zeros_like(sin_o), cos_o], axis=-1)
    return np.asarray(2 * (half * view).sum(-1, keepdims=True) * half - view)


def _cosine_directions(height: Array, azimuth: Array) -> Array:
    sine = np.sqrt(height)
    up = np.broadcast_to(np.sqrt(1 - height), azimuth.shape)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), up], axis=-1)


def _lookup(pyramid: list[Array], directions: Array, solid_angle: Array) -> Array:
    """Radiance averaged over what each direction stands for, so that no small lamp is missed: between two levels."""
    pixel = (np.pi / pyramid[0].shape[0]) ** 2
    level = np.clip(0.5 * np.log2(np.maximum(solid_angle / pixel, 1)), 0, len(pyramid) - 1)
    lower = np.minimum(level.astype(np.int64), len(pyramid) - 2)
    uv, result = direction_to_latlong_uv(directions), np.empty(directions.shape)
    for index in np.unique(lower):
        chosen = lower == index
        share = (level[chosen] - index)[:, None]
        near, far = (sample_latlong(pyramid[k], uv[chosen]) for k in (index, index + 1))
        result[chosen] = (1 - share) * near + share * far
    return result


def _unit(vectors: NDArray[np.floating]) -> Array:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(np.where(length > 1e-12, vectors / np.maximum(length, 1e-12), 0.0), np.float64)
