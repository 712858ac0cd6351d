"""Whether the picture of a bump statement is a normal map: many programs name one so."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from hir_exporters.reading.material_overrides import load_pixels

_SIDEWAYS: Final = 0.15
_UPWARDS: Final = 0.75


def is_normal_map(picture: Path) -> bool:
    """Whether the mean colour is near (128, 128, 255), as that of a tangent space normal map. A height map is grey."""
    pixels, linear = load_pixels(picture)
    if pixels.shape[2] < 3:
        return False
    red, green, blue = pixels[..., :3].mean(axis=(0, 1)) * (0.5 if linear else 1) + (0.5 if linear else 0)
    return bool(abs(red - 0.5) < _SIDEWAYS and abs(green - 0.5) < _SIDEWAYS and blue > _UPWARDS)
