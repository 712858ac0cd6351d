"""How well reflections explain photographs: each pixel is predicted by what others show in the same mirror direction.

The highlights of a curved metal move over its surface as if they lay behind it: a convex mirror of radius R shows a
distant light at a depth of about R/2, which a hollow of that depth explains. What such a surface shows depends on the
direction of the mirrored view alone, and of a matt opening that direction explains nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from hir_core.capture import Array
from hir_core.mesh.ray_casting import MeshQueries
from hir_plugins.initializers.hollows.photo_prediction import BlurredPhotograph, Pixels
from hir_plugins.initializers.surface.volume import Volume

LOBE_DEGREES = 8.0
"""Standard deviation of the kernel over mirror directions."""

NORMAL_VOXELS = 2.0
"""Standard deviation, in voxels, of the smoothing of the volume whose gradient is the normal: a hull of 64 voxels has
steps."""

LEAST_WEIGHT = 1.0
"""Sum of the kernel over other pixels, below which nothing predicts a pixel."""


def reflection_errors(
    pixels: Mapping[int, Pixels],
    volume: Volume,
    surface: MeshQueries,
    photographs: Sequence[BlurredPhotograph],
) -> dict[int, NDArray[np.float64]]:
    """Squared error of each pixel of the photographs with these indices, summed over channels.

    The prediction is the mean colour of the pixels of other photographs of the take, weighted by how near their mirror
    directions are. NaN where there are none, or where a ray misses the `surface`; `volume` has its normals.
    """
    smooth = gaussian_filter(volume.values, NORMAL_VOXELS)
    inward = np.stack(np.gradient(smooth), axis=-1)
    mirrored, colors, owner = [], [], np.repeat(list(pixels), [len(chosen) for chosen in pixels.values()])
    for i, chosen in pixels.items():
        mirrored.append(_mirror_directions(*photographs[i].camera.rays(chosen + 0.5), surface, volume, inward))
        colors.append(photographs[i].colors[chosen[:, 1], chosen[:, 0]].astype(np.float64))
    directions, color = np.concatenate(mirrored), np.concatenate(colors)
    known = np.isfinite(directions[:, 0])
    take = np.array([photographs[i].take for i in owner])
    errors = {}
    for i in pixels:
        own, others = owner == i, known & (owner != i) & (take == photographs[i].take)
        cosine = np.nan_to_num(directions[own]) @ directions[others].T
        weight = np.exp((cosine - 1) / np.radians(LOBE_DEGREES) ** 2)
        total = weight.sum(axis=1)
        predicted = weight @ color[others] / np.maximum(total, 1e-12)[:, None]
        error = ((predicted - color[own]) ** 2).sum(axis=1)
        errors[i] = np.where(known[own] & (total >= LEAST_WEIGHT), error, np.nan)
    return errors


def _mirror_directions(origins: Array, directions: Array, surface: MeshQueries, volume: Volume, inward: Array) -> Array:
    """Unit directions (N, 3) in which the surface mirrors rays; NaN where they miss it or it has no normal."""
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    distance = surface.first_distances(origins, directions).astype(np.float64)
    hit = np.isfinite(distance)
    points = origins + directions * np.where(hit, distance, 0)[:, None]
    cells = ((points - volume.origin) / volume.spacing).T
    normal = np.stack([map_coordinates(inward[..., axis], cells, order=1, mode="nearest") for axis in range(3)], axis=1)
    length = np.linalg.norm(normal, axis=1)
    normal /= np.maximum(length, 1e-12)[:, None]
    mirrored = directions - 2 * (directions * normal).sum(axis=1, keepdims=True) * normal
    return np.where((hit & (length > 1e-9 * volume.spacing))[:, None], mirrored, np.nan)
