"""Verifies an exported file against its asset: the file is read from disk by independent libraries and compared."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from hir_exporters.asset import Asset, AssetMesh
from hir_exporters.errors import ExportError
from hir_exporters.materials.conversion_residuals import metallic_residual, specular_residual
from hir_exporters.materials.material_conversion import to_gltf
from hir_exporters.materials.surfaces import SpecularSurface
from hir_exporters.materials.texture_packing import is_flat
from hir_exporters.reading.gltf_readback import read_gltf
from hir_exporters.reading.readback import ReadBack
from hir_exporters.reading.usd_reading.usd_import import read_untrusted_usd
from hir_exporters.reading.usd_reading.usd_readback import read_usd

READERS: Final[Mapping[str, Callable[[Path], ReadBack]]] = {
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".usda": read_usd,
    ".usdc": read_usd,
    ".usdz": read_usd,
}
"""The function that reads a file back, by suffix."""


@dataclass(frozen=True)
class Verification:
    """The differences between a file and its asset."""

    file: Path
    positions: float
    """Largest distance between corners, relative to the bounding box's diagonal."""
    uvs: float
    """Largest difference of a texture coordinate."""
    normals_degrees: float
    """Largest angle between normals of corners."""
    brdf: float
    """Relative error on the BRDF slice of the material as read back, including the error of 8-bit textures."""
    problems: tuple[str, ...]
    """One sentence for each property that the format can represent and the file has wrong."""


def verify_file(path: Path, asset: Asset, profile: str = "khr") -> Verification:
    """Reads `path` back and compares it with the asset; `profile` is that of a glTF file, engine with its own material.

    The asset must be the one that was written, after any reduction to a budget: positions and UVs are compared corner
    by corner. Raises `InputError` for files that cannot be read, `ExportError` for other formats.
    """
    path = Path(path)
    return compare_with_asset(path, asset, read_back(path), profile)


def read_back(path: Path, *, untrusted: bool = False) -> ReadBack:
    """The content of a file as independent libraries read it.

    `untrusted`: the file is from elsewhere, so that USD is read in a subprocess. Raises `ExportError` for suffixes not
    in `READERS`, `InputError` for files that cannot be read.
    """
    if path.suffix not in READERS:
        raise ExportError(f"{path}: no independent reader checks {path.suffix!r} files")
    reader = READERS[path.suffix]
    return read_untrusted_usd(path) if untrusted and reader is read_usd else reader(path)


def compare_with_asset(path: Path, asset: Asset, back: ReadBack, profile: str = "khr") -> Verification:
    """Compares the content of a file with the asset as `verify_file` does; `path` is only for the messages."""
    mesh, problems = asset.mesh, []
    if back.corner_positions.shape != (len(mesh.faces), 3, 3):
        problems.append(f"{path.name} has {len(back.corner_positions)} triangles instead of {len(mesh.faces)}")
        return Verification(path, 1.0, 1.0, 180.0, 1.0, tuple(problems))
    back = _with_matching_corners(back, mesh)
    size = float(np.linalg.norm(mesh.positions.max(axis=0) - mesh.positions.min(axis=0))) or 1.0
    positions = float(np.abs(back.corner_positions - mesh.positions[mesh.faces]).max()) / size
    uvs = float(np.abs(back.corner_uvs - mesh.uvs[mesh.faces]).max())
    actual, expected = (
        n / np.linalg.norm(n, axis=-1, keepdims=True)
        for n in (back.corner_normals, mesh.normals[mesh.faces].astype(np.float64))
    )
    # By the chord: the arc cosine near 1 would turn rounding into hundredths of a degree.
    normals = float(np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(actual - expected, axis=-1) / 2, 0, 1))).max())
    if back.specular_surface is not None:
        brdf = specular_residual(asset.material, back.specular_surface)
    else:
        blender = profile == "blender" and asset.material.model == "paper"
        expected = to_gltf(asset.material, "engine") if profile == "engine" else None
        assert not isinstance(expected, SpecularSurface)
        brdf = metallic_residual(asset.material, back.surface, as_blender=blender, expected=expected)
    if positions > 1e-4:
        problems.append(f"{path.name}: positions differ by {positions:.2g} of the object's size")
    if uvs > 1e-3:
        problems.append(f"{path.name}: texture coordinates differ by {uvs:.2g}")
    if normals > 2:
        problems.append(f"{path.name}: normals differ by {normals:.2g} degrees")
    normal = asset.material.normal
    if (back.normal is None) is not (normal is None or is_flat(normal)):  # flat maps are not written
        problems.append(
            f"{path.name}: the normal map is missing"
            if back.normal is None
            else f"{path.name}: it has a normal map, the asset has none"
        )
    return Verification(path, positions, uvs, normals, brdf, tuple(problems))


def _with_matching_corners(back: ReadBack, mesh: AssetMesh) -> ReadBack:
    """Triangles with the same first corner as in the mesh: codecs may permute the corners cyclically."""
    expected = np.concatenate([mesh.positions, mesh.uvs], axis=1)[mesh.faces]
    actual = np.concatenate([back.corner_positions, back.corner_uvs], axis=-1)
    rotations = [(np.arange(3) + k) % 3 for k in range(3)]
    difference = np.stack([np.abs(actual[:, rotation] - expected).sum(axis=(1, 2)) for rotation in rotations])
    order = np.asarray(rotations)[difference.argmin(axis=0)][:, :, None]  # the first one if several are equal
    positions, normals, uvs = (
        np.take_along_axis(values, order, axis=1)
        for values in (back.corner_positions, back.corner_normals, back.corner_uvs)
    )
    return replace(back, corner_positions=positions, corner_normals=normals, corner_uvs=uvs)
