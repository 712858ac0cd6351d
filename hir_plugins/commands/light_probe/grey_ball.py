"""The brightness of lamps that a mirror ball clips, from the irradiance that a matt grey ball shows (Debevec 1998)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from hir_exporters.conventions import latlong_directions, latlong_solid_angles
from hir_exporters.textures.bilinear import sample_bilinear
from numpy.typing import NDArray

from hir_core.capture import Array, View
from hir_core.errors import InputError
from hir_plugins.commands.light_probe.mirror_ball import WHOLE_COVERAGE, LightProbe
from hir_plugins.commands.light_probe.sphere_fit import Sphere

SAMPLES = 400
"""Pixels of each photograph: neighbouring normals have nearly the same irradiance."""
MIN_COSINE = 0.3
"""Between the ball's normal and the direction to the camera: at grazing angles paint is glossy."""
MIN_SAMPLES = 50
MAX_REGIONS = 16
"""Clipped regions with a brightness of their own, the largest ones; the others share one."""
MAX_FACTOR = 1e6


def with_lamps_of_grey_ball(
    probe: LightProbe, views: Sequence[View], ball: Sphere, world_from_file: Array, reflectance: float
) -> tuple[LightProbe, float]:
    """The light whose clipped regions have the brightness that the ball asks for, one factor for each region and
    channel, and the median relative deviation between its irradiance and the ball's.

    `InputError` where the photographs show too little of the ball unclipped.
    """
    from scipy.optimize import lsq_linear

    normals, measured = _irradiances(views, ball, reflectance)
    if len(measured) < MIN_SAMPLES:
        raise InputError("the photographs of the grey ball show too little of it unclipped; expose them less")
    height, width, _ = probe.radiance.shape
    directions = latlong_directions(height, width).reshape(-1, 3) @ world_from_file.T
    solid = np.broadcast_to(latlong_solid_angles(height, width), (height, width)).reshape(-1)
    kernel = np.maximum(normals @ directions.T, 0) * solid
    region = _regions(probe.clipped_texels).reshape(-1)
    radiance = probe.radiance.reshape(-1, 3).astype(np.float64)
    result = radiance.copy()
    if region.any():
        members = np.stack([region == number for number in range(1, region.max() + 1)], axis=1)
        for channel in range(3):
            weight = 1 / measured[:, channel]
            rest = kernel @ np.where(region == 0, radiance[:, channel], 0)
            columns = kernel @ (members * radiance[:, channel, None])
            found = lsq_linear(
                columns * weight[:, None], (measured[:, channel] - rest) * weight, bounds=(1.0, MAX_FACTOR)
            )
            result[:, channel] *= np.where(region > 0, (members @ found.x), 1.0)
    deviation = float(np.median(np.abs(kernel @ result / measured - 1)))
    return replace(probe, radiance=result.reshape(probe.radiance.shape).astype(np.float32)), deviation


def _irradiances(views: Sequence[View], ball: Sphere, reflectance: float) -> tuple[Array, Array]:
    """Unit normals (N, 3) of points of the ball, and the irradiance (N, 3) that they show."""
    normals, found = [], []
    for number, view in enumerate(views):
        assert view.camera is not None
        pixels = view.pixels()
        assert pixels.mask is not None
        rows, columns = np.nonzero((pixels.mask > WHOLE_COVERAGE) & ~pixels.saturated)
        chosen = np.random.default_rng(number).permutation(len(rows))[:SAMPLES]
        at = np.stack([columns[chosen], rows[chosen]], axis=1) + 0.5
        origins, rays = view.camera.rays(at)
        offset = origins - ball.center
        middle = np.einsum("ij,ij->i", offset, rays)
        root = middle**2 - np.einsum("ij,ij->i", offset, offset) + ball.radius**2
        normal = (offset + (-middle - np.sqrt(np.maximum(root, 0)))[:, None] * rays) / ball.radius
        color = np.asarray(sample_bilinear(pixels.color_linear, at[:, 0] - 0.5, at[:, 1] - 0.5), np.float64)
        used = (root > 0) & (-np.einsum("ij,ij->i", normal, rays) > MIN_COSINE) & (color > 0).all(axis=1)
        normals.append(normal[used])
        found.append(math.pi * color[used] / (view.gain * reflectance))
    return np.concatenate(normals), np.concatenate(found)


def _regions(clipped: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Connected regions of a lat-long image, which continues over its left and right border: 1, 2, …; 0 elsewhere."""
    from scipy.ndimage import label

    found, count = label(clipped, np.ones((3, 3)))
    for row in range(len(found)):
        for other in range(max(row - 1, 0), min(row + 2, len(found))):
            left, right = found[row, 0], found[other, -1]
            if left and right and left != right:
                found[found == right] = left
    sizes = np.bincount(found.reshape(-1), minlength=count + 1)
    sizes[0] = 0
    order = [number for number in np.argsort(-sizes).tolist() if sizes[number]]
    result = np.zeros(found.shape, np.int64)
    for rank, number in enumerate(order):
        result[found == number] = min(rank + 1, MAX_REGIONS)
    return result
