"""Reads an environment light from a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hir_exporters.asset import AssetEnvironment
from hir_exporters.errors import InputError
from hir_exporters.textures.image_files import read_exr, read_hdr


def read_environment(path: Path) -> AssetEnvironment:
    """The lat-long light of a .hdr or .exr, +Z in its centre, in world axes. Negative values become 0."""
    if path.suffix.lower() not in (".hdr", ".exr"):
        raise InputError(f"{path}: an environment is a lat-long .hdr or .exr")
    radiance = read_exr(path, channels=3) if path.suffix.lower() == ".exr" else read_hdr(path)
    return AssetEnvironment(np.maximum(radiance, 0))
