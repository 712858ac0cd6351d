"""Reads an environment light from a file."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Final

import numpy as np

from hir_exporters.asset import AssetEnvironment
from hir_exporters.errors import InputError
from hir_exporters.textures.image_files import read_exr, read_hdr

ASPECT_TOLERANCE: Final = 0.02
"""Largest relative difference of the width of a lat-long image from twice its height."""
NEGATIVE_SHARE: Final = 0.001
"""Of all light: filters that resample images overshoot a little, and so little changes no picture."""


def read_environment(path: Path) -> AssetEnvironment:
    """The lat-long light of a .hdr or .exr, +Z in its centre, in world axes. Negative values become 0."""
    if path.suffix.lower() not in (".hdr", ".exr"):
        raise InputError(f"{path}: an environment is a lat-long .hdr or .exr")
    radiance = read_exr(path, channels=3) if path.suffix.lower() == ".exr" else read_hdr(path)
    below = -float(np.minimum(radiance, 0).sum(dtype=np.float64))
    if below > NEGATIVE_SHARE * float(np.abs(radiance).sum(dtype=np.float64)):
        warnings.warn(
            f"{path} has negative values, which become 0; write the light again without a filter that sharpens",
            stacklevel=2,
        )
    return AssetEnvironment(np.maximum(radiance, 0))


def read_light(path: Path) -> AssetEnvironment:
    """As `read_environment`, for a file of a user: `InputError` where the image is not twice as wide as high."""
    found = read_environment(path)
    height, width = found.radiance.shape[:2]
    if abs(width - 2 * height) > max(1, ASPECT_TOLERANCE * width):
        raise InputError(f"{path} has {width} x {height} pixels; a lat-long image is twice as wide as high; convert it")
    return found
