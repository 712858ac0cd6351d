"""Openings of a hull: flat regions whose colour changes with the direction, because they are not the surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import (
    binary_closing,
    binary_dilation,
    binary_erosion,
    binary_fill_holes,
    distance_transform_edt,
    gaussian_filter,
    label,
    map_coordinates,
)

from hir_core.capture import Array
from hir_plugins.initializers.surface.volume import Volume

SHARES = (0.02, 0.04, 0.08, 0.16, 0.32)
"""Of the surface, by decreasing variance of its colour: connected parts of these are candidates for openings."""

LEAST_SHARE = 0.004
"""Of the surface, that an opening has."""

FLAT = 0.8
"""Least cosine between the normals of an opening and their mean."""

SAME = 0.8
"""Intersection over union from which two candidates count as one."""

Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Opening:
    """A plane region that is sunk into a volume, in voxels of it."""

    axes: Array
    """(2, 3), orthonormal, in the plane."""
    normal: Array
    """(3,), outward."""
    level: float
    """Of the plane along the normal."""
    corner: Array
    """(2,), coordinates of the first cell of `region`."""
    region: Flags
    """(A, B), cells of one voxel."""
    rounding: float = 0.0
    """How the floor rises towards the outline: 0 not at all, as in a mug; 1 like a quarter of an ellipse, as in a bowl;
    in between it rises in that share of the way from the outline to the middle."""

    def floor(self, distance: Array) -> Array:
        """Depth of the floor at distances from the outline, as a share of the depth in the middle."""
        if self.rounding == 0:
            return np.ones_like(distance)
        width = max(self.rounding * float(distance_transform_edt(np.pad(self.region, 1)).max()), 1e-9)
        return np.asarray(np.sqrt(1 - (1 - np.clip(distance / width, 0, 1)) ** 2))

    def cells(self, points: NDArray[np.number]) -> tuple[NDArray[np.int64], Flags]:
        """The cells (N, 2) of points (N, 3), clipped, and whether each lies in the rectangle of cells."""
        cell = np.floor(points @ self.axes.T - self.corner + 0.5).astype(np.int64)
        inside = np.asarray(((cell >= 0) & (cell < self.region.shape)).all(axis=1))
        return np.clip(cell, 0, np.array(self.region.shape) - 1), inside

    def cell_centers(self) -> Array:
        """The middles (N, 3) of the cells of the region."""
        return np.asarray((np.argwhere(self.region) + self.corner) @ self.axes + self.level * self.normal)

    def contains(self, points: NDArray[np.number]) -> Flags:
        """Whether the columns of the region contain the points (N, 3)."""
        cell, inside = self.cells(points)
        return inside & self.region[tuple(cell.T)]

    def distance(self, points: Array) -> Array:
        """Distance of points (N, 3) from the wall of the columns in voxels, positive inside the region."""
        signed = distance_transform_edt(self.region) - distance_transform_edt(~self.region)
        signed = np.where(signed > 0, signed - 0.5, signed + 0.5)
        cells = (points @ self.axes.T - self.corner).T
        return np.asarray(map_coordinates(signed, cells, order=1, mode="nearest"))

    def moved(self, sectors: NDArray[np.int64], chosen: Sequence[int], step: int) -> Opening:
        """The opening whose edge is `step` cells farther out in the chosen sectors; farther in where it is negative.
        `sectors` (A, B) has the number of the sector of each cell.
        """
        change = binary_dilation if step > 0 else binary_erosion
        other = change(self.region, iterations=abs(step))
        region = np.where(np.isin(sectors, chosen), other, self.region)
        return replace(self, region=region)

    def smoothed(self, sigma: float) -> Opening:
        """The opening with an outline without detail of less than `sigma` voxels."""
        region = gaussian_filter(np.pad(self.region, 2).astype(np.float32), sigma) > 0.5
        return replace(self, corner=self.corner - 2, region=region)

    def sectors(self, count: int) -> NDArray[np.int64]:
        """The sector of each cell (A, B), by its angle around the middle of the region."""
        cells = np.argwhere(np.ones_like(self.region)) - np.argwhere(self.region).mean(axis=0)
        angle = np.arctan2(cells[:, 1], cells[:, 0]) / (2 * np.pi) + 0.5
        return np.asarray((np.minimum(angle, 0.999999) * count).astype(np.int64).reshape(self.region.shape))

    def grown(self, margin: int) -> Opening:
        """The opening with a region that is larger by `margin` voxels."""
        if margin == 0:
            return self
        region = binary_dilation(np.pad(self.region, margin), iterations=margin)
        return replace(self, corner=self.corner - margin, region=region)


def surface_cells(inside: Flags) -> NDArray[np.int64]:
    """Indices (N, 3) of the voxels inside that have a neighbour outside."""
    return np.argwhere(inside & ~binary_erosion(inside, border_value=0))


def find_openings(volume: Volume, cells: NDArray[np.int64], variance: Array, known: Flags) -> list[Opening]:
    """Candidates, those with the largest sum of variance first.

    `variance` (N,) is that of the colour of the surface's `cells` (N, 3), where it is `known` (N,).
    """
    shape = volume.values.shape
    smooth = _smoothed(shape, cells, variance, known)
    normals = outward_normals(volume, cells)
    found: list[tuple[float, Opening, set[int]]] = []
    for share in SHARES:
        if not known.any():
            break
        high = known & (smooth >= np.quantile(smooth[known], 1 - share))
        marked = np.zeros(shape, bool)
        marked[tuple(cells[high].T)] = True
        regions, count = label(marked, np.ones((3, 3, 3)))
        numbers = regions[tuple(cells.T)]
        for number in range(1, count + 1):
            chosen = np.flatnonzero(numbers == number)
            if len(chosen) < LEAST_SHARE * len(cells):
                continue
            mean = normals[chosen].mean(axis=0)
            mean /= max(float(np.linalg.norm(mean)), 1e-9)
            chosen = chosen[normals[chosen] @ mean > FLAT]
            if len(chosen) < LEAST_SHARE * len(cells) or _is_known(set(chosen.tolist()), [f[2] for f in found]):
                continue
            found.append((float(smooth[chosen].sum()), _opening(cells[chosen], mean), set(chosen.tolist())))
    return [opening for _, opening, _ in sorted(found, key=lambda each: -each[0])]


def outward_normals(volume: Volume, cells: NDArray[np.int64]) -> Array:
    """Unit normals (N, 3) at voxels, from the smoothed inside."""
    inside = gaussian_filter((volume.values > 0).astype(np.float32), 2.0)
    normals = -np.stack([axis[tuple(cells.T)] for axis in np.gradient(inside)], axis=1)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9))


def _smoothed(shape: tuple[int, ...], cells: NDArray[np.int64], variance: Array, known: Flags) -> Array:
    """The variance, averaged over neighbouring cells of the surface."""
    total, weight = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    total[tuple(cells[known].T)], weight[tuple(cells[known].T)] = variance[known], 1
    mean = gaussian_filter(total, 1.5) / np.maximum(gaussian_filter(weight, 1.5), 1e-4)
    return np.asarray(mean[tuple(cells.T)], dtype=np.float64)


def _is_known(chosen: set[int], others: Sequence[set[int]]) -> bool:
    return any(len(chosen & other) > SAME * len(chosen | other) for other in others)


def _opening(cells: NDArray[np.int64], outward: Array) -> Opening:
    """Of the least-squares plane of the cells."""
    normal = np.linalg.svd(cells - cells.mean(axis=0), full_matrices=False)[2][2]
    normal = normal * np.sign(normal @ outward)
    axes = np.linalg.svd(normal[None])[2][1:]
    place = cells @ axes.T
    corner = np.floor(place.min(axis=0)) - 8
    size = np.ceil(place.max(axis=0) - corner).astype(int) + 9
    region = np.zeros(size, bool)
    region[tuple(np.floor(place - corner + 0.5).astype(int).T)] = True
    region = binary_fill_holes(binary_closing(region, iterations=2))
    return Opening(axes, normal, float(np.median(cells @ normal)), corner, region)
