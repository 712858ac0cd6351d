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

    def shown(self, points: Array) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Indices of the points (N, 3) inside the mask, and the colours there, whatever is in front of the points."""
        column, row, inside = self.pixels_of(points)
        index = np.flatnonzero(inside)
        index = index[self.valid[row[index], column[index]]]
        return index, self.colors[row[index], column[index]]

    def seen(self, points: Array, surface: MeshQueries, lift: float) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Indices of the points (N, 3) that the photograph sees, and their colours there. `lift` is the distance from
        the surface at which rays to the camera begin.
        """
        index, colors = self.shown(points)
        free = ~surface.occluded(*lifted_rays(points[index], self.camera.center, lift))
        return index[free], colors[free]

    def multiplied(self, factors: Array) -> BlurredPhotograph:
        """With another exposure: factors (3,) of the linear colours."""
        linear = srgb_to_linear(self.colors.astype(np.float64)) * factors
        return replace(self, colors=linear_to_srgb(linear).astype(np.float32))

    def pixels_of(self, points: Array) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
        """Column and row (N,) of each point, clipped to the picture, and whether the point lies in it."""
        pixels, depth = self.camera.project(points)
        # components in arrays of their own: numpy is slow along a short dimension
        column = np.floor(np.clip(pixels[:, 0], -1e6, 1e6)).astype(np.int64)
        row = np.floor(np.clip(pixels[:, 1], -1e6, 1e6)).astype(np.int64)
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


@dataclass(frozen=True, eq=False)
class PredictedPixels:
    """Pixels of photographs that others predict, and their rays: all that a prediction needs of them but a surface."""

    photographs: Sequence[BlurredPhotograph]
    owner: NDArray[np.int64]
    """(N,) index of each pixel's photograph."""
    origins: Array
    """(N, 3)"""
    directions: Array
    """(N, 3), of length 1."""
    colors: NDArray[np.float32]
    """(N, 3)"""
    degrees: Array
    """(J, J) angle between photographs, seen from the origin; NaN between a photograph and itself or another take."""

    @classmethod
    def of(cls, pixels: Mapping[int, Pixels], photographs: Sequence[BlurredPhotograph]) -> PredictedPixels:
        """Pixels of the photographs with these indices."""
        toward = np.stack([photograph.camera.center for photograph in photographs])
        toward /= np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-12)
        degrees = np.degrees(np.arccos(np.clip(toward @ toward.T, -1, 1)))
        take = np.array([photograph.take for photograph in photographs])
        degrees[take[:, None] != take] = np.nan
        np.fill_diagonal(degrees, np.nan)
        rays = [photographs[i].camera.rays(chosen + 0.5) for i, chosen in pixels.items()]
        origins, directions = (np.concatenate(each) for each in zip(*rays, strict=True))
        colors = [photographs[i].colors[chosen[:, 1], chosen[:, 0]] for i, chosen in pixels.items()]
        owner = np.repeat(list(pixels), [len(chosen) for chosen in pixels.values()])
        return cls(photographs, owner, origins, directions, np.concatenate(colors), degrees)

    def errors(self, surface: MeshQueries, lift: float, least_degrees: float = 0.0) -> dict[int, NDArray[np.float64]]:
        """Squared error of each pixel of each photograph, summed over channels; NaN where fewer than
        `LEAST_PHOTOGRAPHS` others of its take see the point that it shows. `lift` is the distance from the surface at
        which rays to cameras begin, `least_degrees` the angle from which on another photograph predicts.
        """
        distance = surface.first_distances(self.origins, self.directions).astype(np.float64)
        hit = np.isfinite(distance)
        points = self.origins + self.directions * np.where(hit, distance, 0)[:, None]
        asked = hit[:, None] & (self.degrees >= least_degrees)[self.owner]
        indices, rays, colors = [], [], []
        for other, photograph in enumerate(self.photographs):
            chosen = np.flatnonzero(asked[:, other])
            index, shown = photograph.shown(points[chosen])
            indices.append(chosen[index])
            rays.append(lifted_rays(points[chosen[index]], photograph.camera.center, lift))
            colors.append(shown)
        # one call for the rays of all photographs, because each call has a cost of its own
        origins, toward = (np.concatenate(each) for each in zip(*rays, strict=True))
        free = ~surface.occluded(origins, toward)
        index, color = np.concatenate(indices)[free], np.concatenate(colors)[free]
        count = np.bincount(index, minlength=len(points))
        total = np.stack([np.bincount(index, color[:, c], len(points)) for c in range(3)], axis=1)
        error = ((total / np.maximum(count, 1)[:, None] - self.colors) ** 2).sum(axis=1)
        error = np.where(hit & (count >= LEAST_PHOTOGRAPHS), error, np.nan)
        return {int(i): error[self.owner == i] for i in dict.fromkeys(self.owner.tolist())}


def lifted_rays(points: Array, center: Array, lift: float) -> tuple[Array, Array]:
    """Origins (N, 3) and unit directions (N, 3) of rays from points to a camera, `lift` away from the points."""
    toward = center - points
    x, y, z = toward.T
    toward /= np.sqrt(x * x + y * y + z * z)[:, None]
    return points + lift * toward, toward
