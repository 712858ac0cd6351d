"""Splits an environment into directional lights and a residual environment.

Real-time engines evaluate directional lights with the exact BRDF, but prefilter an environment with one blur for all
view directions (Karis 2013). So the parts of the light that are much brighter than its mean are written as lights.

Radiance above a threshold becomes lights: the texels are divided into clusters of small angular variance (bisection
along the principal axis, then Lloyd's iterations), and each cluster is one light. What is below the threshold remains
in the environment. A light has the vector irradiance of its cluster: the irradiance of a surface that faces the whole
cluster is that of the original light.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.conventions import latlong_directions, latlong_solid_angles
from hir_exporters.errors import InputError
from hir_exporters.light.environment_map import mean_radiance

Array = NDArray[np.float64]

_SMALLEST_CLUSTER_RAD: Final = 0.02
"""Clusters of a smaller angular standard deviation are not divided: no engine shows lobes that narrow."""

_LEAST_SHARE: Final = 1e-3
"""A light with less than this share of the whole light's energy stays in the residual."""

_LLOYD_ITERATIONS: Final = 8


@dataclass(frozen=True, eq=False)
class LightSplit:
    """Directional lights and the environment without them."""

    directions: Array
    """(N, 3) unit vectors towards the lights, world axes."""
    irradiance: Array
    """(N, 3) linear, on a surface that faces the light: radiance times steradian."""
    residual: NDArray[np.float32]
    """(H, 2H, 3) radiance of the environment that remains."""

    @property
    def share(self) -> float:
        """Fraction of the light's energy that is in the lights."""
        lights = float(self.irradiance.sum())
        whole = lights + 4 * np.pi * float(mean_radiance(self.residual).sum())
        return lights / whole if whole > 0 else 0.0


def split_light(radiance: NDArray[np.floating], max_lights: int, threshold: float) -> LightSplit:
    """At most `max_lights` lights of a lat-long image (H, 2H, 3) in world axes, brightest first, and the residual.

    Texels whose largest channel is above `threshold` times the mean radiance become lights; that much of them remains.
    Raises `InputError` for another shape, and for values that are negative, NaN or infinite.
    """
    values = _checked(radiance)
    mean = float(mean_radiance(values).mean())
    peak = values.max(axis=-1)
    above = peak > threshold * mean
    if max_lights < 1 or mean <= 0 or not above.any():
        return LightSplit(np.zeros((0, 3)), np.zeros((0, 3)), values.astype(np.float32))

    height, width = peak.shape
    rows, columns = np.nonzero(above)
    # The whole texel keeps its colour: what remains has the threshold as its largest channel.
    excess = values[rows, columns] * (1 - threshold * mean / peak[rows, columns])[:, None]
    solid_angle = np.broadcast_to(latlong_solid_angles(height, width), (height, width))[rows, columns]
    directions = latlong_directions(height, width)[rows, columns]
    energy = excess * solid_angle[:, None]
    labels = _clusters(directions, energy.sum(axis=1), max_lights)

    total = 4 * np.pi * float(mean_radiance(values).sum())
    residual, lights = values.copy(), []
    for label in range(int(labels.max()) + 1):
        members = labels == label
        vector = energy[members].T @ directions[members]  # (channel, axis)
        length = np.linalg.norm(vector.sum(axis=0))
        if length < _LEAST_SHARE * total:
            continue
        residual[rows[members], columns[members]] -= excess[members]
        toward = vector.sum(axis=0) / length
        lights.append((np.maximum(vector @ toward, 0), toward))
    lights.sort(key=lambda light: -float(light[0].sum()))
    return LightSplit(
        np.array([toward for _, toward in lights]).reshape(-1, 3),
        np.array([light for light, _ in lights]).reshape(-1, 3),
        np.maximum(residual, 0).astype(np.float32),
    )


def rotation_to(toward: Array) -> list[float]:
    """Unit quaternion (x, y, z, w) that rotates +Z to `toward`: lights shine along their -Z, away from it."""
    x, y, z = (float(value) for value in toward)
    if z < -1 + 1e-12:
        return [1.0, 0.0, 0.0, 0.0]  # opposite: half a turn about +X
    quaternion = np.array([-y, x, 0.0, 1 + z])
    return [float(value) for value in quaternion / np.linalg.norm(quaternion)]


def _clusters(directions: Array, weights: Array, count: int) -> NDArray[np.intp]:
    """Labels (T,) of at most `count` clusters of weighted directions (T, 3)."""
    labels = np.zeros(len(directions), np.intp)
    for new in range(1, count):
        variances = [_principal_axis(directions[labels == k], weights[labels == k]) for k in range(new)]
        worst = int(np.argmax([energy * variance for energy, variance, _ in variances]))
        _, variance, axis = variances[worst]
        if variance < _SMALLEST_CLUSTER_RAD**2:
            break
        members = np.flatnonzero(labels == worst)
        along = directions[members] @ axis
        split = along > np.average(along, weights=weights[members])
        labels[members[split]] = new
    for _ in range(_LLOYD_ITERATIONS):
        means = np.stack([weights[labels == k] @ directions[labels == k] for k in range(labels.max() + 1)])
        # opposite lamps in one cluster have no mean direction
        means /= np.maximum(np.linalg.norm(means, axis=-1, keepdims=True), 1e-300)
        # an empty cluster disappears: labels are numbered without gaps
        labels = np.unique((directions @ means.T).argmax(axis=1), return_inverse=True)[1]
    return labels


def _principal_axis(directions: Array, weights: Array) -> tuple[float, float, Array]:
    """Energy of a cluster, its largest variance along an axis, and that axis."""
    total = float(weights.sum())
    centred = directions - weights @ directions / total
    covariance = (centred * weights[:, None]).T @ centred / total
    eigenvalues, axes = np.linalg.eigh(covariance)
    return total, float(eigenvalues[-1]), axes[:, -1]


def _checked(radiance: NDArray[np.floating]) -> Array:
    values = np.asarray(radiance, np.float64)
    if values.ndim != 3 or values.shape[2] != 3 or values.shape[1] != 2 * values.shape[0] or not len(values):
        raise InputError(f"the environment has the shape {values.shape}; it must be (H, 2H, 3)")
    bad = values.size - int(np.isfinite(values).sum())
    if bad:
        raise InputError(f"the environment contains {bad} NaN or infinite values; remove or replace them")
    if values.min() < 0:
        raise InputError("the environment contains negative radiance; set it to 0")
    return values
