"""An exporter: Stanford PLY with the albedo as vertex colours."""

from __future__ import annotations

import time
from pathlib import Path
from typing import final

import numpy as np
from hir_exporters.asset import Asset, validate_asset
from hir_exporters.conventions import linear_to_srgb
from hir_exporters.exporter import Edit, Exporter, ExportReport
from hir_exporters.files.atomic import write_bytes_atomic
from numpy.typing import NDArray

from hir_core.errors import ConfigError
from hir_example.options import PlyOptions

HEADER = """ply
format binary_little_endian 1.0
comment {name}
element vertex {vertices}
property float x
property float y
property float z
property float nx
property float ny
property float nz
property uchar red
property uchar green
property uchar blue
element face {faces}
property list uchar int vertex_indices
end_header
"""


@final
class ColoredPly(Exporter):
    """Positions, normals and sRGB colours, little endian."""

    def __init__(self, config: PlyOptions) -> None:
        if config.color not in ("diffuse_albedo", "specular_albedo"):
            raise ConfigError(f"exporter.ply.color is {config.color!r}; it is diffuse_albedo or specular_albedo")
        self._color = config.color

    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        """Writes one file; the report names what PLY cannot store."""
        start = time.perf_counter()
        validate_asset(asset)
        mesh = asset.mesh
        color = np.clip(linear_to_srgb(vertex_colors(getattr(asset.material, self._color), mesh.uvs)), 0, 1)
        vertices = np.zeros(len(mesh.positions), dtype=[("place", "<f4", 3), ("normal", "<f4", 3), ("color", "u1", 3)])
        vertices["place"], vertices["normal"] = mesh.positions, mesh.normals
        vertices["color"] = np.rint(255 * color)
        faces = np.zeros(len(mesh.faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
        faces["count"], faces["corners"] = 3, mesh.faces
        name = asset.name.encode("ascii", "replace").decode().replace("\n", " ")
        header = HEADER.format(name=name, vertices=len(vertices), faces=len(faces)).encode("ascii")
        write_bytes_atomic(destination, header + vertices.tobytes() + faces.tobytes())
        warning = "PLY holds colours at vertices: texture finer than the mesh, gloss and light are not written"
        return ExportReport((Path(destination),), (warning,), {}, time.perf_counter() - start)


def vertex_colors(texture: NDArray[np.float32], uvs: NDArray[np.float32]) -> NDArray[np.float64]:
    """Linear colour (V, 3) of a texture (H, W, 3), bilinear, or of one value (3,), at texture coordinates."""
    if texture.ndim == 1:
        return np.broadcast_to(texture.astype(np.float64), (len(uvs), 3))
    height, width = texture.shape[:2]
    x = np.clip(uvs[:, 0] * width - 0.5, 0, width - 1)
    y = np.clip(uvs[:, 1] * height - 0.5, 0, height - 1)
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    s, t = (x - left)[:, None], (y - top)[:, None]
    upper = texture[top, left] * (1 - s) + texture[top, right] * s
    lower = texture[bottom, left] * (1 - s) + texture[bottom, right] * s
    return upper * (1 - t) + lower * t
