"""The file that a run's surface was read from, with the texture that it has there.

A scan's texture holds the light of its photographs. It is kept for comparison with the result: no stage after the
initializers is given it, so that a fit sees photographs, masks and cameras alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from hir_exporters.textures.image_files import read_rgb8, write_png
from numpy.typing import NDArray

from hir_core.errors import InputError
from hir_core.files.contained_files import regular_file_within
from hir_core.files.json_documents import read_json, write_json

DOCUMENT, TEXTURE = "scan.json", "scan_texture.png"

UV_TOLERANCE = 1e-3
"""Texture coordinates of a scan may leave 0…1 by this: programs round the border."""


@dataclass(frozen=True, eq=False)
class Scan:
    """A mesh file, read by an initializer."""

    file: str
    """Name of the file, for messages."""
    texture: NDArray[np.uint8] | None = None
    """sRGB codes (H, W, 3), row 0 at v = 0, for the texture coordinates of the mesh; None where it has no texture."""


def save_scan(scan: Scan | None, folder: Path) -> None:
    """Writes a scan into the folder of a stage, so that `load_scan` returns the same; nothing for None."""
    if scan is None:
        return
    write_json(folder / DOCUMENT, {"file": scan.file})
    if scan.texture is not None:
        write_png(folder / TEXTURE, scan.texture)


def load_scan(folder: Path) -> Scan | None:
    """The scan that `save_scan` wrote; None where there is none. `InputError` where it is damaged."""
    if not (folder / DOCUMENT).exists():
        return None
    file = read_json(regular_file_within(folder, folder / DOCUMENT)).get("file")
    if not isinstance(file, str):
        raise InputError(f"{folder / DOCUMENT} does not name a file; run again with --resume")
    path = folder / TEXTURE
    texture = read_rgb8(regular_file_within(folder, path)) if path.exists() else None
    return Scan(file, texture)
