"""What is read back from an exported file, in one form for all formats.

No code is shared with the exporters. `hir_exporters.reading.file_verification` compares it with the asset.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hir_exporters.errors import InputError
from hir_exporters.materials.surfaces import MetallicSurface, SpecularSurface


@dataclass(frozen=True)
class ReadBack:
    """Triangle corners and material of a file."""

    corner_positions: NDArray[np.float64]
    """(F, 3, 3)."""
    corner_normals: NDArray[np.float64]
    """(F, 3, 3)."""
    corner_uvs: NDArray[np.float64]
    """(F, 3, 2), origin top-left."""
    surface: MetallicSurface
    """With the extensions that the exporters write; for USD the inputs of the metallic workflow."""
    specular_surface: SpecularSurface | None
    """Specular-glossiness or UsdPreviewSurface's specular workflow, where the file has it."""
    normal: NDArray[np.float32] | None
    """(H, W, 3) decoded tangent space normals."""


def index_of_refraction(value: object, path: Path) -> float:
    """0 (which KHR_materials_ior defines as no Fresnel effect) or at least 1; anything else raises `InputError`."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not (value == 0 or 1 <= value < 1e6):
        raise InputError(f"{path}: the index of refraction is {str(value)[:40]}; it is 0 or at least 1")
    return float(value)
