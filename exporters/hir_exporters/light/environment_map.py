"""Lat-long environment maps: energy-preserving rotation and resampling, and spherical harmonics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import Asset, AssetEnvironment
from hir_exporters.conventions import direction_to_latlong_uv, latlong_directions, latlong_solid_angles
from hir_exporters.errors import ExportError
from hir_exporters.textures.bilinear import sample_bilinear

Array = NDArray[np.float64]

FIRST_VIEW_KEY = "first_view_to_world"
"""Key of an asset's provenance: rotation (3, 3) from the first view's camera axes to the world's."""


def world_radiance(asset: Asset, height: int = 0) -> tuple[NDArray[np.float32], tuple[str, ...]]:
    """The asset's environment in world axes as a 2:1 lat-long image (H, 2H, 3), and warnings.

    A light that moves with the camera is placed as it was for the first view. `height` 0 keeps the resolution of the
    finer axis. Raises `ExportError` where the asset has no environment.
    """
    environment = asset.environment
    no_warnings: tuple[str, ...] = ()
    if environment is None:
        raise ExportError(
            f"asset {asset.name!r} has no environment, so there is no light to write; give it one (hir export --light)"
        )
    rotation, warnings = environment.to_world, no_warnings
    if environment.frame == "camera":
        rotation, warnings = _camera_rotation(environment, asset.provenance)
    rows, columns = environment.radiance.shape[:2]
    height = height or max(rows, -(-columns // 2))
    radiance = rotate_latlong(resample_latlong(environment.radiance, height, 2 * height), rotation)
    return radiance.astype(np.float32), warnings


def resample_latlong(radiance: NDArray[np.floating], height: int, width: int) -> Array:
    """The image at another size: each new pixel is the mean over its solid angle, which preserves the total energy."""
    values = np.asarray(radiance, np.float64)
    if values.shape[:2] == (height, width):
        return values
    down = _overlap(np.cos(np.linspace(np.pi, 0, values.shape[0] + 1)), np.cos(np.linspace(np.pi, 0, height + 1)))
    across = _overlap(np.linspace(0, 1, values.shape[1] + 1), np.linspace(0, 1, width + 1))
    return np.einsum("ij,jkc,lk->ilc", down[::-1, ::-1], values, across, optimize=True)


def rotate_latlong(radiance: NDArray[np.floating], to_world: NDArray[np.floating]) -> Array:
    """The light rotated by `to_world` (3, 3): radiance from direction d comes from `to_world @ d` afterwards.

    Four bilinear samples a pixel; then each channel is scaled to its former energy. The identity changes nothing, and
    rotations about +Y by whole pixels move pixels without blur.
    """
    values, rotation = np.asarray(radiance, np.float64), np.asarray(to_world, np.float64)
    height, width, _ = values.shape
    if np.allclose(rotation @ [0, 1, 0], [0, 1, 0], atol=1e-12):
        # A rotation about +Y increases the azimuth atan2(x, z) by its angle, and u decreases with the azimuth.
        shift = -np.arctan2(rotation[0, 2], rotation[2, 2]) / (2 * np.pi) * width
        if abs(shift - round(shift)) < 1e-9 * width:
            return np.roll(values, round(shift), axis=1)
    fine = latlong_directions(2 * height, 2 * width) @ rotation  # rows are directions: d @ R is R^T d
    rotated = sample_latlong(values, direction_to_latlong_uv(fine)).reshape(height, 2, width, 2, -1)
    weight = latlong_solid_angles(2 * height, 2 * width).reshape(height, 2, 1, 1, 1)
    rotated = (rotated * weight).sum((1, 3)) / (2 * weight.sum(1)[:, :, 0])
    before, after = mean_radiance(values), mean_radiance(rotated)
    return rotated * np.where(after > 0, before / np.maximum(after, 1e-300), 1.0)


def mean_radiance(radiance: NDArray[np.floating]) -> Array:
    """Mean of each channel (C,) over the sphere."""
    weight = latlong_solid_angles(*radiance.shape[:2])
    return np.asarray((radiance * weight[..., None]).sum((0, 1)) / (weight.sum() * radiance.shape[1]), np.float64)


def spherical_harmonics(radiance: NDArray[np.floating]) -> Array:
    """Coefficients (9, 3) of radiance in the real basis, bands 0 to 2, m = -l .. l (Ramamoorthi, Hanrahan 2001)."""
    height, width, _ = radiance.shape
    weight = latlong_solid_angles(height, width)[..., None] * np.asarray(radiance, np.float64)
    return np.einsum("hwk,hwc->kc", harmonic_basis(latlong_directions(height, width)), weight)


def irradiance_harmonics(radiance: NDArray[np.floating]) -> Array:
    """Coefficients (9, 3) of irradiance: radiance convolved with the clamped cosine, band by band (ibid., eq. 8)."""
    bands = np.repeat([np.pi, 2 * np.pi / 3, np.pi / 4], [1, 3, 5])
    return spherical_harmonics(radiance) * bands[:, None]


def harmonic_basis(directions: Array) -> Array:
    """The nine real spherical harmonics (..., 9) at unit directions (..., 3)."""
    x, y, z = np.moveaxis(directions, -1, 0)
    values = [
        np.full_like(x, 0.5 * np.sqrt(1 / np.pi)),
        np.sqrt(3 / (4 * np.pi)) * y,
        np.sqrt(3 / (4 * np.pi)) * z,
        np.sqrt(3 / (4 * np.pi)) * x,
        0.5 * np.sqrt(15 / np.pi) * x * y,
        0.5 * np.sqrt(15 / np.pi) * y * z,
        0.25 * np.sqrt(5 / np.pi) * (3 * z * z - 1),
        0.5 * np.sqrt(15 / np.pi) * x * z,
        0.25 * np.sqrt(15 / np.pi) * (x * x - y * y),
    ]
    return np.stack(values, axis=-1)


def _camera_rotation(environment: AssetEnvironment, provenance: Mapping[str, Any]) -> tuple[Array, tuple[str, ...]]:
    try:
        view = np.asarray(provenance.get(FIRST_VIEW_KEY), np.float64)
    except (TypeError, ValueError):
        view = np.zeros(0)
    if view.shape == (3, 3) and np.abs(view @ view.T - np.eye(3)).max() < 1e-4:
        warning = "the light moved with the camera; it is written as it was for the first view"
        return view @ environment.to_world, (warning,)
    return environment.to_world, (
        f"the light moved with the camera; provenance has no {FIRST_VIEW_KEY!r}, so it is written in camera axes",
    )


def _overlap(old: Array, new: Array) -> Array:
    """Fraction (new, old) of each old interval in each new one; rows sum to 1. Both are given by increasing edges."""
    low = np.maximum(old[None, :-1], new[:-1, None])
    high = np.minimum(old[None, 1:], new[1:, None])
    return np.maximum(high - low, 0.0) / (new[1:] - new[:-1])[:, None]


def sample_latlong(values: Array, uv: NDArray[np.floating]) -> Array:
    """Bilinear samples (..., C) of a lat-long image (H, W, C) at uv (..., 2): u wraps around, v stops at the poles."""
    height, width = values.shape[:2]
    return np.asarray(
        sample_bilinear(values, uv[..., 0] * width - 0.5, uv[..., 1] * height - 0.5, "wrap_columns"), np.float64
    )


def latlong_pyramid(radiance: Array) -> list[Array]:
    """Mipmap levels of a lat-long image (H, 2H, 3), each half as large as the one before, down to four rows."""
    levels = [radiance]
    while levels[-1].shape[0] > 4:
        height = levels[-1].shape[0] // 2
        levels.append(resample_latlong(levels[-1], height, 2 * height))
    return levels
