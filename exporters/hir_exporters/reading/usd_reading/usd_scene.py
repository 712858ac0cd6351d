"""Which meshes of a USD stage are seen, and the matrices to an asset's axes and unit."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.errors import InputError

if TYPE_CHECKING:
    from pxr import Usd, UsdGeom

MAX_MESHES: Final = 10_000
"""Meshes of all instances together."""

_Z_UP_TO_Y_UP: Final = ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))
"""For row vectors, as OpenUSD multiplies: z becomes y, y becomes -z."""


def visible_meshes(stage: Usd.Stage, path: Path) -> list[UsdGeom.Mesh]:
    """The meshes that a renderer shows, those of instances included: visible, with the purpose default or render.

    Raises `InputError` for point instancers; warns of surfaces that are no meshes, which are left out.
    """
    from pxr import Usd, UsdGeom

    meshes, left_out = [], set()
    prims = iter(Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)))
    for prim in prims:
        shape = UsdGeom.Imageable(prim)
        if not shape:
            continue
        if shape.GetVisibilityAttr().Get(Usd.TimeCode.EarliestTime()) == UsdGeom.Tokens.invisible:
            prims.PruneChildren()
            continue
        instancer = prim.IsA(UsdGeom.PointInstancer)
        if instancer:
            prims.PruneChildren()  # its prototypes
        if not (instancer or prim.IsA(UsdGeom.Gprim)) or shape.ComputePurpose() not in ("default", "render"):
            continue
        if instancer:
            raise InputError(f"{path}: {prim.GetPath()} is a point instancer; make its instances meshes first")
        if prim.IsA(UsdGeom.Mesh):
            meshes.append(UsdGeom.Mesh(prim))
        else:
            left_out.add(str(prim.GetTypeName()))
        if len(meshes) > MAX_MESHES:
            raise InputError(f"{path} has more than {MAX_MESHES} meshes; join them first")
    if left_out:
        warnings.warn(
            f"{path} has prims of the type {', '.join(sorted(left_out))}, which are left out; make them meshes first",
            stacklevel=3,
        )
    return meshes


def stage_axes(stage: Usd.Stage, path: Path, in_meters: bool) -> NDArray[np.float64]:
    """Matrix (4, 4) for row vectors from the stage's world to +Y up, and to metres with `in_meters`."""
    from pxr import UsdGeom

    axes = np.eye(4)
    up = UsdGeom.GetStageUpAxis(stage)
    if up not in (UsdGeom.Tokens.y, UsdGeom.Tokens.z):
        raise InputError(f"{path}: upAxis is {str(up)!r}; it is Y or Z")
    if up == UsdGeom.Tokens.z:
        axes[:3, :3] = _Z_UP_TO_Y_UP
    if in_meters:
        unit = UsdGeom.GetStageMetersPerUnit(stage)
        if not (math.isfinite(unit) and unit > 0):
            raise InputError(f"{path}: metersPerUnit is {unit}; it must be greater than 0")
        axes[:3, :3] *= unit
    return axes


def placement(mesh: UsdGeom.Mesh, axes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matrix (4, 4) for row vectors from a mesh's points through its own and its parents' transforms and `axes`."""
    from pxr import Usd

    local_to_world = mesh.ComputeLocalToWorldTransform(Usd.TimeCode.EarliestTime())
    return np.asarray(local_to_world, np.float64) @ axes
