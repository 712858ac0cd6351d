"""How well a surface explains photographs: each pixel is predicted by the mean colour that others show at its point.

A prediction by all photographs of a take that see the point, from whatever direction, is good on a surface whose colour
does not depend on the direction, and on no reflection.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from hir_exporters.conventions import linear_to_srgb, srgb_to_linear
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from hir_core.capture import Array, Camera, Capture
from hir_core.mesh.ray_casting import MeshQueries

LEAST_PHOTOGRAPHS = 2
"""Others that must see a point; fewer predict nothing."""

Pixels = NDArray[np.int64]
"""(N, 2), column and row."""


@dataclass(frozen=True)
class BlurredPhotograph:
    """Colours as a surface of coarse voxels can predict them."""

    camera: Camera
    take: int
    colors: NDArray[np.float32]
    """(H, W, 3), encoded as sRGB, blurred inside the mask."""
    valid: NDArray[np.bool_]
    """(H, W): pixels inside the mask."""
    gain: NDArray[np.float32]
    """(3,): the linear colours are radiance × gain."""
    sigma: float
    """Standard deviation of the blur, in pixels."""

    def seen(self, points: Array, surface: MeshQueries, lift: float) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Indices of the points (N, 3) that the photograph sees, and their colours there. `lift` is the distance from
        the surface at which rays to the camera begin.
        """
        column, row, inside = self.pixels_of(points)
        index = np.flatnonzero(inside)
        index = index[self.valid[row[index], column[index]]]
        toward = self.camera.center - points[index]
        toward /= np.linalg.norm(toward, axis=1, keepdims=True)
        index = index[~surface.occluded(points[index] + lift * toward, toward)]
        return index, self.colors[row[index], column[index]]

    def multiplied(self, factors: Array) -> BlurredPhotograph:
        """With another exposure: factors (3,) of the linear colours."""
        linear = srgb_to_linear(self.colors.astype(np.float64)) * factors
        return replace(self, colors=linear_to_srgb(linear).astype(np.float32))

    def pixels_of(self, points: Array) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
        """Column and row (N,) of each point, clipped to the picture, and whether the point lies in it."""
        pixels, depth = self.camera.project(points)
        column, row = np.floor(np.clip(pixels, -1e6, 1e6)).astype(np.int64).T
        width, height = self.camera.width, self.camera.height
        inside = (depth > 0) & (column >= 0) & (row >= 0) & (column < width) & (row < height)
        return np.clip(column, 0, width - 1), np.clip(row, 0, height - 1), inside


def blurred_photographs(capture: Capture, length: float) -> list[BlurredPhotograph]:
    """All masked photographs with a camera, blurred by a Gaussian with a standard deviation of `length` world units at
    the origin, where the object stands.
    """
    found = []
    for view, take in zip(capture.views, capture.take_numbers, strict=True):
        if view.camera is None:
            continue
        sigma = length * view.camera.intrinsics[0, 0] / max(float(np.linalg.norm(view.camera.center)), 1e-9)
        factor = max(1, int(sigma / 2))
        pixels, camera, sigma = view.pixels(factor), view.camera.downsampled(factor), sigma / factor
        if pixels.mask is None:
            continue
        valid = pixels.mask > 0.95
        blurred = blurred_colors(pixels.color_linear, valid, sigma)
        found.append(BlurredPhotograph(camera, take, blurred, valid, view.gain, sigma))
    return found


def blurred_colors(linear: NDArray[np.floating], valid: NDArray[np.bool_], sigma: float) -> NDArray[np.float32]:
    """Linear colours (H, W, 3), encoded as sRGB and blurred inside a mask (H, W)."""
    weight = gaussian_filter(valid.astype(np.float32), sigma)
    colors = linear_to_srgb(np.clip(linear, 0, 1)) * valid[..., None]
    total = gaussian_filter(colors.astype(np.float32), (sigma, sigma, 0))
    return np.asarray(total / np.maximum(weight, 1e-3)[..., None])


def color_variance(
    points: Array, surface: MeshQueries, photographs: Sequence[BlurredPhotograph], lift: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Variance of the colour of each point (N,) between the photographs of a take, pooled over takes, and how many
    photographs see the point. 0 where fewer than `LEAST_PHOTOGRAPHS` do.
    """
    deviations, freedom = np.zeros(len(points)), np.zeros(len(points), np.int64)
    count = np.zeros(len(points), np.int64)
    for take in {photograph.take for photograph in photographs}:
        total, squares = np.zeros((len(points), 3)), np.zeros(len(points))
        seen = np.zeros(len(points), np.int64)
        for photograph in photographs:
            if photograph.take == take:
                index, colors = photograph.seen(points, surface, lift)
                total[index] += colors
                squares[index] += (colors.astype(np.float64) ** 2).sum(axis=1)
                seen[index] += 1
        deviations += np.maximum(squares - (total**2).sum(axis=1) / np.maximum(seen, 1), 0)
        freedom += np.maximum(seen - 1, 0)
        count += seen
    known = count >= LEAST_PHOTOGRAPHS
    return np.where(known, deviations / np.maximum(freedom, 1), 0.0), count


def prediction_errors(
    pixels: Mapping[int, Pixels],
    surface: MeshQueries,
    photographs: Sequence[BlurredPhotograph],
    lift: float,
    least_degrees: float = 0.0,
) -> dict[int, NDArray[np.float64]]:
    """Squared error of each pixel of the photographs with these indices, summed over channels; NaN where fewer than
    `LEAST_PHOTOGRAPHS` others of its take see the point that it shows. `least_degrees` is the angle, seen from the
    origin, from which on another photograph predicts.
    """
    toward = np.stack([photograph.camera.center for photograph in photographs])
    toward /= np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-12)
    degrees = np.degrees(np.arccos(np.clip(toward @ toward.T, -1, 1)))
    owner = np.repeat(list(pixels), [len(chosen) for chosen in pixels.values()])
    points, hits, own = [], [], []
    for i, chosen in pixels.items():
        origins, directions = photographs[i].camera.rays(chosen + 0.5)
        distance = surface.first_distances(origins, directions).astype(np.float64)
        reached = np.isfinite(distance)
        points.append(origins + directions * np.where(reached, distance, 0)[:, None])
        hits.append(reached)
        own.append(photographs[i].colors[chosen[:, 1], chosen[:, 0]])
    positions, hit = np.concatenate(points), np.concatenate(hits)
    take = np.array([photographs[i].take for i in owner])
    total, count = np.zeros((len(positions), 3)), np.zeros(len(positions), np.int64)
    for j, other in enumerate(photographs):
        asked = np.flatnonzero(hit & (owner != j) & (take == other.take) & (degrees[owner, j] >= least_degrees))
        index, colors = other.seen(positions[asked], surface, lift)
        total[asked[index]] += colors
        count[asked[index]] += 1
    error = ((total / np.maximum(count, 1)[:, None] - np.concatenate(own)) ** 2).sum(axis=1)
    error = np.where(hit & (count >= LEAST_PHOTOGRAPHS), error, np.nan)
    return {i: error[owner == i] for i in pixels}
