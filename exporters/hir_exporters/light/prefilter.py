"""The environment prefiltered for real-time engines: a cubemap whose smaller levels are blurred by wider GGX lobes.

Level 0 is the light itself. A texel of level k is the mean radiance over a GGX lobe around its direction with
n = v = r, weighted by n.l: the first factor of the split-sum approximation (Karis 2013).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.conventions import direction_to_latlong_uv, latlong_directions, latlong_solid_angles
from hir_exporters.light.environment_map import latlong_pyramid, sample_latlong
from hir_exporters.mesh.tangent_frames import tangent_frames

Array = NDArray[np.float64]

FACES: Final = ("+X", "-X", "+Y", "-Y", "+Z", "-Z")
"""Order of the faces in every container."""

LAST_LEVEL_SIZE: Final = 16
"""Side of the last level in pixels, which is for roughness 1; smaller levels could not represent its gradients."""

_FIBONACCI_LATTICES: Final = ((0.05, 34, 21), (0.2, 89, 55))
"""(largest alpha, half vectors for each texel, lattice step): the last two are consecutive Fibonacci numbers."""

_WIDE_LOBE_ROWS: Final = 64
"""Rows of the reduced light for lobes wider than those of `_FIBONACCI_LATTICES`, which sum over all its pixels."""


def level_sizes(size: int) -> list[int]:
    """Sides of the levels from `size`, a power of two, down to `LAST_LEVEL_SIZE`."""
    sizes = [size]
    while sizes[-1] > LAST_LEVEL_SIZE:
        sizes.append(sizes[-1] // 2)
    return sizes


def linear_roughness(level: int, levels: int) -> float:
    """Perceptual roughness of a level as EXT_lights_image_based has it: linear in the level."""
    return level / (levels - 1) if levels > 1 else 0.0


def filament_roughness(level: int, levels: int) -> float:
    """Perceptual roughness r of a level as Filament's cmgen has it: level / (levels - 1) = r (2 - r)."""
    return 1 - float(np.sqrt(1 - linear_roughness(level, levels)))


def face_directions(size: int) -> Array:
    """Unit directions (6, size, size, 3) of texel centres in world axes: OpenGL's faces, row 0 first in memory."""
    edge = (np.arange(size) + 0.5) / size * 2 - 1
    s, t = np.meshgrid(edge, edge)
    one = np.ones_like(s)
    faces = np.stack(
        [
            np.stack([one, -t, -s], -1),
            np.stack([-one, -t, s], -1),
            np.stack([s, one, t], -1),
            np.stack([s, -one, -t], -1),
            np.stack([s, -t, one], -1),
            np.stack([-s, -t, -one], -1),
        ]
    )
    return np.asarray(faces / np.linalg.norm(faces, axis=-1, keepdims=True))


def prefiltered_cubemap(radiance: NDArray[np.floating], roughness: list[float], size: int) -> list[Array]:
    """Levels (6, S, S, 3) of a lat-long image (H, 2H, 3) in world axes, one for each perceptual roughness.

    Narrow lobes are sampled from a mipmap level that fits the solid angle of a sample, so that no small lamp is missed.
    """
    pyramid = latlong_pyramid(np.asarray(radiance, np.float64))
    return [
        _filtered(pyramid, face_directions(side), rough**2, 4 * np.pi / (6 * side**2))
        for side, rough in zip(level_sizes(size), roughness, strict=True)
    ]


def prefiltered_latlong(radiance: NDArray[np.floating], levels: Sequence[tuple[float, int]]) -> list[Array]:
    """Images (rows, 2 rows, 3) of a lat-long image (H, 2H, 3) in world axes, for pairs (perceptual roughness, rows)."""
    pyramid = latlong_pyramid(np.asarray(radiance, np.float64))
    return [
        _filtered(pyramid, latlong_directions(rows, 2 * rows), rough**2, (np.pi / rows) ** 2) for rough, rows in levels
    ]


def _filtered(pyramid: list[Array], directions: Array, alpha: float, texel: float) -> Array:
    """The light around `directions`, which are `texel` steradians apart."""
    if alpha < 1e-3:
        return _lookup(pyramid, directions, texel)
    for largest_alpha, samples, step in _FIBONACCI_LATTICES:
        if alpha <= largest_alpha:
            return _importance_sampled(pyramid, directions, alpha, texel, samples, step)
    return _integrated(next(level for level in pyramid if level.shape[0] <= _WIDE_LOBE_ROWS), directions, alpha)


def _importance_sampled(
    pyramid: list[Array], directions: Array, alpha: float, texel: float, samples: int, step: int
) -> Array:
    """A lattice of half vectors with the density D (n.h); each lookup averages over the solid angle of its sample."""
    u = (np.arange(samples) + 0.5) / samples
    phi = 2 * np.pi * (np.arange(samples) * step / samples % 1.0)
    cos_h = np.sqrt((1 - u) / (1 + (alpha * alpha - 1) * u))
    cos_l = 2 * cos_h * cos_h - 1
    above = cos_l > 0
    cos_h, cos_l, phi = cos_h[above], cos_l[above], phi[above]
    density = _distribution(cos_h, alpha) / 4  # of light directions: D (n.h) / (4 (v.h)) with v = n
    sin_l = np.sqrt(1 - cos_l**2)
    local = np.stack([sin_l * np.cos(phi), sin_l * np.sin(phi), cos_l], -1)
    frame = tangent_frames(directions.reshape(-1, 3))
    result = np.zeros((len(frame), 3))
    for direction, weight, solid in zip(local, cos_l, 1 / (samples * density), strict=True):
        result += weight * _lookup(pyramid, frame @ direction, max(float(solid), texel))
    return np.asarray((result / cos_l.sum()).reshape(directions.shape))


def _integrated(radiance: Array, directions: Array, alpha: float) -> Array:
    """The integral as a sum over all pixels of a small image."""
    height, width = radiance.shape[:2]
    lights = latlong_directions(height, width).reshape(-1, 3)
    values = np.concatenate([radiance.reshape(-1, 3), np.ones((height * width, 1))], axis=1)
    values *= np.repeat(latlong_solid_angles(height, width)[:, 0], width)[:, None]
    flat, result = directions.reshape(-1, 3), []
    for part in np.array_split(flat, max(1, len(flat) // 512)):
        cos_l = np.clip(part @ lights.T, 0, 1).astype(np.float32)  # (texels, pixels)
        weight = cos_l * _distribution(np.sqrt((1 + cos_l) / 2), alpha)
        total = weight @ values.astype(np.float32)
        result.append(total[:, :3] / total[:, 3:])
    return np.concatenate(result).astype(np.float64).reshape(directions.shape)


def _distribution(cos_h: NDArray[np.floating], alpha: float) -> NDArray[np.floating]:
    return alpha**2 / (np.pi * (cos_h * cos_h * (alpha**2 - 1) + 1) ** 2)


def _lookup(pyramid: list[Array], directions: Array, solid_angle: float) -> Array:
    """Radiance (..., 3) around directions, averaged over about `solid_angle`: linear between two mipmap levels."""
    pixel = (np.pi / pyramid[0].shape[0]) ** 2
    level = float(np.clip(0.5 * np.log2(max(solid_angle / pixel, 1e-12)), 0, len(pyramid) - 1))
    lower = min(int(level), len(pyramid) - 1)
    uv = direction_to_latlong_uv(directions)
    value = sample_latlong(pyramid[lower], uv)
    share = level - lower
    if share > 0:
        value = (1 - share) * value + share * sample_latlong(pyramid[lower + 1], uv)
    return np.asarray(value)
