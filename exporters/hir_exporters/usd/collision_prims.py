"""Convex hulls as collision shapes of UsdPhysics: meshes with the purpose `guide`, which renderers do not show."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hir_exporters.mesh.convex_decomposition import ConvexHull

if TYPE_CHECKING:
    from pxr import Usd


def add_collision_prims(stage: Usd.Stage, hulls: Sequence[ConvexHull]) -> None:
    """Adds `Collision/Hull_00` and so on below the default prim of a stage."""
    from pxr import UsdGeom, UsdPhysics, Vt

    scope = UsdGeom.Scope.Define(stage, stage.GetDefaultPrim().GetPath().AppendChild("Collision"))
    scope.CreatePurposeAttr(UsdGeom.Tokens.guide)
    for index, hull in enumerate(hulls):
        mesh = UsdGeom.Mesh.Define(stage, scope.GetPath().AppendChild(f"Hull_{index:02d}"))
        mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(hull.positions)))
        mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(hull.faces), 3, np.int32)))
        mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(hull.faces.reshape(-1))))
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(mesh.GetPointsAttr().Get()))
        UsdPhysics.CollisionAPI.Apply(mesh.GetPrim())
        approximation = UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim())
        approximation.CreateApproximationAttr(UsdPhysics.Tokens.convexHull)
