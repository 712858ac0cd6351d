"""Triangle corners of one USD mesh: polygons, orientation, and values by their interpolation."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.errors import InputError
from hir_exporters.mesh.polygon_triangulation import triangulate
from hir_exporters.mesh.vertex_normals import angle_weighted_normals, unit_or_zero
from hir_exporters.reading.gltf_geometry.gltf_mesh import CornerMesh
from hir_exporters.reading.usd_reading.texture_coordinates import TextureCoordinates, chosen_primvar

if TYPE_CHECKING:
    from pxr import UsdGeom

Array = NDArray[np.float64]

MAX_CORNERS: Final = 50_000_000
"""Corners of the polygons of one mesh."""

_UNIT_TOLERANCE: Final = 1e-5
"""Normals whose length differs less from 1 are left as they are; rounding to float32 makes 1e-7."""


@dataclass(frozen=True)
class _Topology:
    """The triangles of a mesh, by the elements that values belong to."""

    mesh: str
    path: Path
    sizes: dict[str, int]
    """Values that each interpolation needs."""
    points: NDArray[np.int64]
    """(F, 3) points of the corners."""
    corners: NDArray[np.int64]
    """(F, 3) corners of polygons."""
    polygons: NDArray[np.int64]
    """(F,)."""
    in_order: bool
    """Whether the triangles are those of the file, corner by corner."""

    def at_corners(self, values: Array, interpolation: str, what: str) -> Array:
        """Values (F, 3, C) of corners. Raises `InputError` where there are not as many as the interpolation needs."""
        expected = self.sizes.get(interpolation)
        if expected is None or len(values) != expected:
            needed = "is unknown" if expected is None else f"needs {expected}"
            raise InputError(
                f"{self.path}: the mesh {self.mesh} has {len(values)} {what}, and the interpolation "
                f"{interpolation!r} {needed}; export it again"
            )
        if interpolation == "faceVarying":
            return values.reshape(*self.points.shape, -1) if self.in_order else np.take(values, self.corners, axis=0)
        if interpolation == "uniform":
            return np.repeat(values[self.polygons][:, None], 3, axis=1)
        if interpolation == "constant":
            return np.broadcast_to(values[0], (*self.points.shape, values.shape[1]))
        return np.take(values, self.points, axis=0)


def polygon_count(mesh: UsdGeom.Mesh) -> int:
    return len(_values(mesh.GetFaceVertexCountsAttr(), np.int64))


def read_corners(mesh: UsdGeom.Mesh, to_asset: Array, coordinates: TextureCoordinates, path: Path) -> CornerMesh:
    """Triangle corners of a mesh, in the axes that `to_asset` (4, 4, for row vectors) leads to.

    Normals that the file lacks are those of points, weighted by the angles of the triangles.
    """
    name, linear = str(mesh.GetPath()), to_asset[:3, :3]
    determinant = float(np.linalg.det(linear))
    if not (np.isfinite(to_asset).all() and determinant != 0):
        raise InputError(f"{path}: the transform of the mesh {name} is singular; give it a scale other than 0")
    points = _values(mesh.GetPointsAttr(), np.float64).reshape(-1, 3)
    left_handed = mesh.GetOrientationAttr().Get() == "leftHanded"
    topology = _topology(mesh, points, left_handed is not (determinant < 0), path)
    if not np.array_equal(to_asset, np.eye(4)):
        points = points @ linear + to_asset[3, :3]
    positions = np.take(points, topology.points, axis=0)
    normals, interpolation = _authored_normals(mesh, name, path)
    _warn_of_subdivision(mesh, normals is not None, path)
    if normals is None:
        corner_normals = angle_weighted_normals(points, topology.points)[topology.points]
    else:
        normals = _unit(normals if np.array_equal(linear, np.eye(3)) else normals @ np.linalg.inv(linear).T)
        corner_normals = topology.at_corners(normals, interpolation, "normals")
        if not normals.any(axis=-1).all():
            known = np.any(corner_normals, axis=-1, keepdims=True)
            corner_normals = np.where(
                known, corner_normals, angle_weighted_normals(points, topology.points)[topology.points]
            )
    primvar = chosen_primvar(mesh, coordinates, path)
    uvs = coordinates.applied(_flattened(primvar, name, path).reshape(-1, 2)) * [1, -1] + [0, 1]
    corner_uvs = topology.at_corners(uvs, primvar.GetInterpolation(), "texture coordinates")
    return CornerMesh(positions, corner_normals, corner_uvs)


def _topology(mesh: UsdGeom.Mesh, points: Array, flipped: bool, path: Path) -> _Topology:
    counts = _values(mesh.GetFaceVertexCountsAttr(), np.int64)
    indices = _values(mesh.GetFaceVertexIndicesAttr(), np.int64)
    name = str(mesh.GetPath())
    if counts.min(initial=0) < 0 or counts.sum() != len(indices):
        raise InputError(
            f"{path}: the polygons of the mesh {name} have {counts.sum()} corners in faceVertexCounts and "
            f"{len(indices)} in faceVertexIndices; export it again"
        )
    if len(indices) > MAX_CORNERS:
        raise InputError(f"{path}: the mesh {name} has more than {MAX_CORNERS} corners; reduce it first")
    if indices.min(initial=0) < 0 or indices.max(initial=-1) >= len(points):
        raise InputError(f"{path}: mesh.faces has an index out of range ({name} has {len(points)} points)")
    triangular = bool((counts == 3).all())
    # Positions of corners are needed only where there are polygons to divide.
    corners, polygons, overlapping = triangulate(counts, points if triangular else points[indices])
    if overlapping:
        warnings.warn(
            f"{path}: the mesh {name} has {overlapping} polygons whose triangles overlap; triangulate it in the "
            "program that made it",
            stacklevel=4,
        )
    shown = ~np.isin(polygons, _values(mesh.GetHoleIndicesAttr(), np.int64))
    corners, polygons = corners[shown], polygons[shown]
    if flipped:
        corners = corners[:, [0, 2, 1]]
    sizes = {
        "constant": 1,
        "uniform": len(counts),
        "varying": len(points),
        "vertex": len(points),
        "faceVarying": len(indices),
    }
    in_order = triangular and not flipped and bool(shown.all())
    points_of_corners = indices.reshape(-1, 3) if in_order else indices[corners]
    return _Topology(name, path, sizes, points_of_corners, corners, polygons, in_order)


def _authored_normals(mesh: UsdGeom.Mesh, name: str, path: Path) -> tuple[Array | None, str]:
    """Normals (K, 3) of the file and their interpolation; the primvar precedes the attribute."""
    from pxr import UsdGeom

    primvar = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("normals")
    if primvar and primvar.HasValue():
        return _flattened(primvar, name, path).reshape(-1, 3), str(primvar.GetInterpolation())
    values = _values(mesh.GetNormalsAttr(), np.float64)
    return (values.reshape(-1, 3), str(mesh.GetNormalsInterpolation())) if values.size else (None, "")


def _warn_of_subdivision(mesh: UsdGeom.Mesh, has_normals: bool, path: Path) -> None:
    """A mesh with normals and without creases whose scheme is not written is polygonal: `catmullClark` is only the
    schema's default.
    """
    attribute = mesh.GetSubdivisionSchemeAttr()
    creased = any(_values(a, np.int64).size for a in (mesh.GetCreaseIndicesAttr(), mesh.GetCornerIndicesAttr()))
    if attribute.Get() != "none" and (attribute.HasAuthoredValue() or creased or not has_normals):
        warnings.warn(
            f"{path}: the mesh {mesh.GetPath()} is a subdivision surface ({attribute.Get()}"
            f"{' with creases' if creased else ''}), of which the control cage is read; subdivide it first, or set its "
            "subdivisionScheme to none",
            stacklevel=4,
        )


def _unit(vectors: Array) -> Array:
    """Unit vectors; 0 for those without a length. Those of unit length are not rounded again."""
    length = np.sqrt(np.einsum("...i,...i", vectors, vectors))[..., None]
    near_unit = np.abs(length - 1) < _UNIT_TOLERANCE
    if near_unit.all():
        return vectors
    return np.where(near_unit, vectors, unit_or_zero(vectors))


def _flattened(primvar: UsdGeom.Primvar, name: str, path: Path) -> Array:
    from pxr import Usd

    values = primvar.ComputeFlattened(Usd.TimeCode.EarliestTime())
    if values is None:
        raise InputError(f"{path}: {primvar.GetName()} of the mesh {name} has an index out of range; export it again")
    return np.asarray(values, np.float64)


def _values(attribute: Any, kind: Any) -> NDArray[Any]:
    """The values of an attribute, at its first time if it is animated; empty where it has none."""
    from pxr import Usd

    values = attribute.Get(Usd.TimeCode.EarliestTime())
    return np.zeros(0, kind) if values is None else np.asarray(values, kind)
