"""Exporter of .obj with an .mtl that uses the PBR statements (Pr, Pm, norm) of Blender, Assimp and others."""

from __future__ import annotations

import re
import time
import zlib
from pathlib import Path
from typing import final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import Asset, AssetMesh, validate_asset
from hir_exporters.exporter import Edit, Exporter, ExportReport, check_file_name, companion_file
from hir_exporters.files.atomic import write_bytes_atomic, write_text_atomic
from hir_exporters.format_options import ObjConfig
from hir_exporters.materials.material_conversion import to_gltf
from hir_exporters.materials.surfaces import MetallicSurface
from hir_exporters.materials.texture_packing import (
    PackedSurface,
    limit_texture_sizes,
    pack_surface,
    texture_size_warnings,
)
from hir_exporters.textures.image_encoding import encode_images


@final
class ObjExporter(Exporter):
    """Geometry without loss; the material as the core metallic-roughness fit."""

    def __init__(self, config: ObjConfig) -> None:
        self._config = config

    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        start, destination = time.perf_counter(), check_file_name(destination, ".obj")
        validate_asset(asset)
        material = limit_texture_sizes(asset.material, self._config.max_texture_size)
        surface = to_gltf(material, "metalrough")
        assert isinstance(surface, MetallicSurface)
        packed = pack_surface(surface, material.normal)
        # The statements cannot select channels: roughness and metalness are separate images.
        pixels = {"base_color": packed.base_color_image, "normal": packed.normal_image}
        if packed.orm_image is not None and packed.roughness_textured:
            pixels["roughness"] = packed.orm_image[..., 1:2]
        if packed.orm_image is not None and packed.metallic_textured:
            pixels["metallic"] = packed.orm_image[..., 2:3]
        images = encode_images({name: image for name, image in pixels.items() if image is not None})
        plain = destination.with_name(_plain(destination.stem) + destination.suffix)
        names = {key: companion_file(plain, image.name).name for key, image in images.items()}

        library = plain.with_suffix(".mtl")
        files = [destination, library, *(destination.with_name(name) for name in names.values())]
        for image, file in zip(images.values(), files[2:], strict=True):
            write_bytes_atomic(file, image.data)
        write_text_atomic(library, material_text(packed, names))
        write_bytes_atomic(
            destination, mesh_text(asset.mesh, library.name, re.sub(r"\s", "_", asset.name)).encode("utf-8")
        )
        residuals = {"metalrough": surface.residual}
        warnings = surface.warnings + texture_size_warnings(asset.material, self._config.max_texture_size)
        return ExportReport(tuple(files), warnings, residuals, time.perf_counter() - start)


def mesh_text(mesh: AssetMesh, library: str, name: str) -> str:
    """Text of the .obj; nine significant digits represent float32 exactly."""
    uvs = mesh.uvs.astype(np.float64) * [1, -1] + [0, 1]
    corners = np.repeat(mesh.faces.reshape(-1, 3) + 1, 3, axis=1)
    return "".join(
        [
            f"mtllib {library}\no {name}\n",
            _lines("v %.9g %.9g %.9g\n", mesh.positions),
            _lines("vt %.9g %.9g\n", uvs),
            _lines("vn %.9g %.9g %.9g\n", mesh.normals),
            "usemtl surface\n",
            _lines("f %d/%d/%d %d/%d/%d %d/%d/%d\n", corners),
        ]
    )


def material_text(packed: PackedSurface, images: dict[str, str]) -> str:
    """Text of the .mtl: constants, then the images that replace them; Ns and Ks are for readers without PBR.

    Beside an image, Pr and Pm are its mean, for readers that know only the constants. Kd is 1, because many readers
    multiply it with the image.
    """
    roughness, metallic = packed.roughness, packed.metallic
    if packed.orm_image is not None:
        means = packed.orm_image.mean(axis=(0, 1)) / 255
        roughness = float(means[1]) if "roughness" in images else roughness
        metallic = float(means[2]) if "metallic" in images else metallic
    alpha = max(roughness, 0.01) ** 2
    exponent = min(max(2 / alpha**2 - 2, 0.0), 1000.0)  # the Blinn-Phong exponent of the same lobe width
    lines = ["newmtl surface", "illum 2", _line("Kd", *packed.base_color), _line("Ks", 0.04, 0.04, 0.04)]
    lines += [_line("Ns", exponent), _line("Ni", packed.ior), _line("Pr", roughness)]
    lines += [_line("Pm", metallic), "d 1"]
    statements = {"base_color": "map_Kd", "roughness": "map_Pr", "metallic": "map_Pm", "normal": "norm"}
    lines += [f"{statement} {images[name]}" for name, statement in statements.items() if name in images]
    return "\n".join(lines) + "\n"


def _line(key: str, *values: float) -> str:
    return " ".join([key, *(f"{value:.6g}" for value in values)])


def _lines(form: str, rows: NDArray[np.generic]) -> str:
    return (form * len(rows)) % tuple(rows.reshape(-1).tolist())


def _plain(name: str) -> str:
    """The name without spaces, which the format cannot quote; names that differ in spaces only stay different."""
    plain = re.sub(r"\s", "_", name)
    return plain if plain == name else f"{plain}_{zlib.crc32(name.encode()):08x}"
