"""Checks of a written file against the asset it was written from, beginning with the bytes on disk."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from hir_exporters.asset import Asset, AssetMesh
from hir_exporters.errors import ExportError
from hir_exporters.materials.conversion_residuals import metallic_residual, specular_residual
from hir_exporters.reading.readback import ReadBack, read_gltf, read_usd
from hir_exporters.reading.usd_import import read_untrusted_usd

READERS: Final[Mapping[str, Callable[[Path], ReadBack]]] = {
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".usda": read_usd,
    ".usdc": read_usd,
    ".usdz": read_usd,
}
"""Who reads a file back, by its suffix."""


@dataclass(frozen=True)
class Verification:
    """How far a file is from its asset."""

    file: Path
    positions: float
    """Largest distance of a corner, relative to the bounding box's diagonal."""
    uvs: float
    """Largest difference of a texture coordinate."""
    normals_degrees: float
    """Largest angle between corner normals."""
    brdf: float
    """Relative error on the BRDF slice of the material as read back, 8-bit textures included."""
    problems: tuple[str, ...]
    """One sentence for each thing that a format should have kept and did not."""


def verify_file(path: Path, asset: Asset, profile: str = "khr") -> Verification:
    """Read `path` back and compare it with the asset. `profile` says whose formula reads the material of a glTF.

    The asset must be the one that was written, with its textures already reduced where a budget did so: positions and
    UVs are compared corner by corner. Raises `InputError` for files that cannot be read, `ExportError` for other
    formats.
    """
    path = Path(path)
    return compare_with_asset(path, asset, read_back(path), profile)


def read_back(path: Path, *, untrusted: bool = False) -> ReadBack:
    """What independent readers see in a file; `foreign`: one that we did not write, which may end OpenUSD's process.

    Raises `ExportError` for suffixes not in `READERS`, `InputError` for files that cannot be read.
    """
    if path.suffix not in READERS:
        raise ExportError(f"{path}: no independent reader checks {path.suffix!r} files")
    reader = READERS[path.suffix]
    return read_untrusted_usd(path) if untrusted and reader is read_usd else reader(path)


def compare_with_asset(path: Path, asset: Asset, back: ReadBack, profile: str = "khr") -> Verification:
    """What was read back against the asset; `path` is named in the problems (`verify_file`)."""
    mesh, problems = asset.mesh, []
    if back.corner_positions.shape != (len(mesh.faces), 3, 3):
        problems.append(f"{path.name} has {len(back.corner_positions)} triangles instead of {len(mesh.faces)}")
        return Verification(path, 1.0, 1.0, 180.0, 1.0, tuple(problems))
    back = _turned(back, mesh)
    size = float(np.linalg.norm(mesh.positions.max(axis=0) - mesh.positions.min(axis=0))) or 1.0
    positions = float(np.abs(back.corner_positions - mesh.positions[mesh.faces]).max()) / size
    uvs = float(np.abs(back.corner_uvs - mesh.uvs[mesh.faces]).max())
    have, want = (
        n / np.linalg.norm(n, axis=-1, keepdims=True)
        for n in (back.corner_normals, mesh.normals[mesh.faces].astype(np.float64))
    )
    # From the chord: acos of a cosine near 1 would show rounding as hundredths of a degree.
    normals = float(np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(have - want, axis=-1) / 2, 0, 1))).max())
    if back.specular_surface is not None:
        brdf = specular_residual(asset.material, back.specular_surface)
    else:
        blender = profile == "blender" and asset.material.model == "paper"
        brdf = metallic_residual(asset.material, back.surface, as_blender=blender)
    if positions > 1e-4:
        problems.append(f"{path.name}: positions moved by {positions:.2g} of the object's size")
    if uvs > 1e-3:
        problems.append(f"{path.name}: texture coordinates moved by {uvs:.2g}")
    if normals > 2:
        problems.append(f"{path.name}: normals turned by {normals:.2g} degrees")
    if (back.normal is None) is not (asset.material.normal is None):
        problems.append(f"{path.name}: the normal map is {'missing' if back.normal is None else 'one too many'}")
    return Verification(path, positions, uvs, normals, brdf, tuple(problems))


def _turned(back: ReadBack, mesh: AssetMesh) -> ReadBack:
    """Triangles with the corner first that is the mesh's first: codecs may turn a triangle without changing it."""
    wanted = np.concatenate([mesh.positions, mesh.uvs], axis=1)[mesh.faces]
    have = np.concatenate([back.corner_positions, back.corner_uvs], axis=-1)
    turns = [(np.arange(3) + k) % 3 for k in range(3)]
    off = np.stack([np.abs(have[:, turn] - wanted).sum(axis=(1, 2)) for turn in turns])
    order = np.asarray(turns)[off.argmin(axis=0)][:, :, None]  # the first where they tie
    positions, normals, uvs = (
        np.take_along_axis(values, order, axis=1)
        for values in (back.corner_positions, back.corner_normals, back.corner_uvs)
    )
    return replace(back, corner_positions=positions, corner_normals=normals, corner_uvs=uvs)
