"""The model's radiance at surface points, and PSNR of what an engine shows there."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import Asset
from hir_exporters.conventions import linear_to_srgb
from hir_exporters.engines.surface_points import SurfacePoints
from hir_exporters.materials.brdf_slice import model_brdf
from hir_exporters.textures.texture_maps import sample_texels

Array = NDArray[np.float64]

PSNR_MAX: Final = 100.0
"""Reported for equal values, in dB."""


def model_radiance(asset: Asset, points: SurfacePoints) -> Array:
    """Linear radiance (N, 3) of the asset's own model."""
    diffuse = sample_texels(asset.material.diffuse_albedo, True, points.uvs)
    specular = sample_texels(asset.material.specular_albedo, True, points.uvs)
    return points.shade(model_brdf(points.slices, asset.material.model, diffuse, specular))


def encoded(linear: Array) -> Array:
    """Clipped sRGB values in [0, 1]."""
    return np.asarray(linear_to_srgb(np.clip(linear, 0, 1)), np.float64)


def psnr_db(picture: Array, reference: Array) -> float:
    """PSNR of encoded values in dB, at most `PSNR_MAX`."""
    error = float(np.mean((picture - reference) ** 2))
    return round(min(-10 * float(np.log10(max(error, 1e-12))), PSNR_MAX), 2)
