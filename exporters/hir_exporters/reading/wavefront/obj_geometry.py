"""Reads the geometry of a Wavefront .obj: positions, texture coordinates, normals, and the triangles that use them."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hir_exporters.errors import InputError
from hir_exporters.mesh.polygon_triangulation import triangulate
from hir_exporters.reading.wavefront.face_corners import read_corners
from hir_exporters.reading.wavefront.obj_statements import Statements, library_names, read_statements, used_materials


@dataclass(frozen=True, eq=False)
class ObjGeometry:
    """The content of an .obj. A corner has its own index of each kind."""

    positions: NDArray[np.float64]
    """(V, 3)."""
    colors: NDArray[np.float64] | None
    """(V, 3), red, green and blue after the position, as the file has them; None without them."""
    uvs: NDArray[np.float64]
    """(U, 2), v upwards."""
    normals: NDArray[np.float64]
    """(N, 3), not normalised."""
    corners: NDArray[np.int64]
    """(T, 3, 3): indices of position, texture coordinate and normal of each corner of each triangle; -1 for none."""
    materials: tuple[str, ...]
    """The materials that faces use, in the order of the file; "" for faces without `usemtl`."""
    libraries: tuple[str, ...]
    """Names of material libraries."""


def read_obj(path: Path) -> ObjGeometry:
    """The geometry of an .obj that passed `check_references`. Raises `InputError` with the line and the remedy.

    A warning counts the polygons whose triangles overlap.
    """
    found = read_statements(path)
    positions = _rows(path, found[b"v"], 3, "mesh.positions does not have three numbers")
    corners = read_corners(path, found[b"f"], (found[b"v"].lines, found[b"vt"].lines, found[b"vn"].lines))
    triangles, _, overlapping = triangulate(corners.sizes, positions[corners.indices[:, 0]])
    if overlapping:
        warnings.warn(
            f"{path} has {overlapping} polygons whose triangles overlap; triangulate the mesh in the "
            "program that made it",
            stacklevel=2,
        )
    return ObjGeometry(
        positions,
        _colors(found[b"v"]),
        _rows(path, found[b"vt"], 2, "mesh.uvs does not have two numbers"),
        _rows(path, found[b"vn"], 3, "mesh.normals does not have three numbers"),
        corners.indices[triangles],
        used_materials(found),
        tuple(dict.fromkeys(name for text in found[b"mtllib"].texts() for name in library_names(text))),
    )


def _rows(path: Path, statements: Statements, columns: int, problem: str) -> NDArray[np.float64]:
    """The first numbers (N, columns) of each statement. A texture coordinate of one number has a v of 0."""
    table = _table(statements.arguments, columns)
    if table is not None:
        return table
    rows = []
    for line, argument in zip(statements.lines, statements.arguments, strict=True):
        try:
            row = [float(part) for part in argument.partition(b"#")[0].split()[:columns]]
        except ValueError:
            row = []
        row += [0.0] if columns == 2 and len(row) == 1 else []
        if len(row) != columns:
            raise InputError(f"{path}: {problem} in line {line}; export it again")
        rows.append(row)
    return np.array(rows, np.float64).reshape(-1, columns)


def _colors(statements: Statements) -> NDArray[np.float64] | None:
    """The fourth to sixth number of all statements (N, 3), where all have six."""
    arguments = statements.arguments
    if not arguments or len(arguments[0].partition(b"#")[0].split()) < 6:
        return None
    table = _table(arguments, 6)
    return None if table is None else table[:, 3:]


def _table(arguments: list[bytes], columns: int) -> NDArray[np.float64] | None:
    """The first numbers of each line (N, columns); None where one has fewer, or something that is not a number."""
    if not arguments:
        return np.zeros((0, columns))
    if any(b"#" in argument for argument in arguments):
        arguments = [argument.partition(b"#")[0] for argument in arguments]
    if not all(map(bytes.strip, arguments)):
        return None  # numpy leaves out empty lines
    try:
        lines = (argument.decode("ascii") for argument in arguments)
        table = np.loadtxt(lines, np.float64, comments=None, usecols=range(columns), ndmin=2)
    except ValueError:
        return None
    return table if len(table) == len(arguments) else None
