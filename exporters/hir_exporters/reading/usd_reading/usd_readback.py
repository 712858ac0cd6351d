"""Reads the mesh and the material of a .usda, .usdc or .usdz with pxr: an exported file, or one of another program."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.errors import InputError
from hir_exporters.reading.gltf_geometry.gltf_mesh import CornerMesh
from hir_exporters.reading.readback import ReadBack
from hir_exporters.reading.usd_reading.mesh_corners import polygon_count, read_corners
from hir_exporters.reading.usd_reading.preview_material import bound_material, read_material
from hir_exporters.reading.usd_reading.usd_containment import check_layers
from hir_exporters.reading.usd_reading.usd_scene import placement, stage_axes, visible_meshes
from hir_exporters.usd_library import require_usd

if TYPE_CHECKING:
    from pxr import Usd, UsdGeom

_MAX_CORNERS: Final = 50_000_000
"""Triangle corners of all meshes together."""

_WRAPS_OF_OTHER_KINDS: Final = frozenset({"black", "clamp", "mirror"})
_UV_TOLERANCE: Final = 1e-3


def read_usd(path: Path, in_meters: bool = False) -> ReadBack:
    """The visible meshes of a file, joined, with their one UsdPreviewSurface, in world axes with +Y up.

    Positions are in the unit of the file, which exporters write unscaled beside `metersPerUnit`; in metres with
    `in_meters`. What is left out is a warning. Raises `InputError` naming the file.
    """
    from pxr import Usd

    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path} does not exist")
    require_usd(path, InputError)
    try:
        check_layers(path)
        stage = Usd.Stage.Open(str(path))
        if errors := stage.GetCompositionErrors():
            raise InputError(
                f"{path} lacks a part ({_one_line(str(errors[0])).rstrip('.')}); put the file beside it, or flatten it"
            )
        return _read_stage(stage, path, in_meters)
    except InputError:
        raise
    except Exception as error:  # OpenUSD's errors, and those of decoding broken text
        raise InputError(f"{path} cannot be read as USD ({_reason(error)}); export it again") from error


def _read_stage(stage: Usd.Stage, path: Path, in_meters: bool) -> ReadBack:
    meshes = [mesh for mesh in visible_meshes(stage, path) if polygon_count(mesh)]
    if not meshes:
        raise InputError(f"{path}: mesh.faces contains no triangles (it has no mesh that is visible)")
    bound = bound_material(meshes, path)
    material = read_material(bound, path)
    axes, total = stage_axes(stage, path, in_meters), 0
    parts: list[CornerMesh] = []
    for mesh in meshes:
        parts.append(read_corners(mesh, placement(mesh, axes), material.coordinates, path))
        total += 3 * len(parts[-1].positions)
        if total > _MAX_CORNERS:
            raise InputError(f"{path} has more than {_MAX_CORNERS} corners in all its meshes; reduce them first")
    if not total:
        raise InputError(
            f"{path}: mesh.faces contains no triangles (its polygons are holes or have fewer than three corners)"
        )
    if len(parts) > 1:
        parts = [CornerMesh(*(np.concatenate(values) for values in zip(*parts, strict=True)))]
    _warn_of_left_out(meshes, bound is None, path)
    if not_repeated := material.wraps & _WRAPS_OF_OTHER_KINDS:
        _warn_of_wraps(parts[0].uvs, not_repeated, path)
    return ReadBack(*parts[0], material.surface, material.specular_surface, material.normal)


def _warn_of_left_out(meshes: Sequence[UsdGeom.Mesh], without_material: bool, path: Path) -> None:
    if without_material and any(mesh.GetDisplayColorAttr().HasAuthoredValue() for mesh in meshes):
        warnings.warn(
            f"{path} has colours in its meshes (displayColor) and no material; bake them to a texture first",
            stacklevel=4,
        )
    if any(mesh.GetPrim().HasAttribute("primvars:skel:jointIndices") for mesh in meshes):
        warnings.warn(f"{path} has a skeleton, which is left out; apply its pose to the mesh first", stacklevel=4)


def _warn_of_wraps(uvs: NDArray[np.float64], wraps: frozenset[str], path: Path) -> None:
    if uvs.min() < -_UV_TOLERANCE or uvs.max() > 1 + _UV_TOLERANCE:
        kinds = " and ".join(sorted(wraps))
        warnings.warn(
            f"{path} has texture coordinates outside of 0 to 1, where its textures have the wrap mode {kinds} and "
            "those of an asset repeat; unwrap the mesh to 0 to 1 first",
            stacklevel=4,
        )


def _reason(error: Exception) -> str:
    """An error on one line, without the places in OpenUSD's source that it names.

    OpenUSD quotes content of broken files that may not be valid text.
    """
    try:
        text = _one_line(str(error))
    except UnicodeDecodeError:
        return type(error).__name__
    quoted = re.search(r"in file \S+ : '(.*?) ?'(?: Error in |$)", text)
    return quoted[1] if quoted else f"{type(error).__name__}: {text}"


def _one_line(text: str) -> str:
    return re.sub(r"\w*__pxrReserved__::(\w+::)*", "", " ".join(text.split()))[:600]
