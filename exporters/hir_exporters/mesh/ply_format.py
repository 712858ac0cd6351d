"""mesh.ply of the open scene format: binary PLY, one vertex for each pair of position and UV, t upwards.

Why not a library: docs/adr/own_implementations.md.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import AssetMesh
from hir_exporters.conventions import flip_v
from hir_exporters.errors import InputError

_COLUMNS = ("x", "y", "z", "nx", "ny", "nz", "s", "t")
_TANGENT_COLUMNS = ("tx", "ty", "tz", "tw")
_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
_SCALARS = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "<i2"),
    **dict.fromkeys(("ushort", "uint16"), "<u2"),
    **dict.fromkeys(("int", "int32"), "<i4"),
    **dict.fromkeys(("uint", "uint32"), "<u4"),
    **dict.fromkeys(("float", "float32"), "<f4"),
    **dict.fromkeys(("double", "float64"), "<f8"),
}


def encode_ply(mesh: AssetMesh) -> bytes:
    """Bytes of mesh.ply: float32 `x y z nx ny nz`, float64 `s t`, then float32 `tx ty tz tw` if there are tangents;
    int32 triangles. 1 - v is exact in float64 where v is 0 or at least 2⁻²⁹, so texture coordinates keep their bits.
    """
    columns = dict(
        zip(_COLUMNS, [*mesh.positions.T, *mesh.normals.T, *flip_v(mesh.uvs.astype(np.float64)).T], strict=True)
    )
    if mesh.tangents is not None:
        columns |= dict(zip(_TANGENT_COLUMNS, mesh.tangents.T, strict=True))
    types = {name: ("double", "<f8") if name in ("s", "t") else ("float", "<f4") for name in columns}
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(mesh.positions)}"]
    header += [f"property {kind} {name}" for name, (kind, _) in types.items()]
    header += [f"element face {len(mesh.faces)}", "property list uchar int vertex_indices", "end_header", ""]
    faces = np.empty(len(mesh.faces), _FACE)
    faces["count"], faces["corners"] = 3, mesh.faces
    vertices = np.empty(len(mesh.positions), np.dtype([(name, kind) for name, (_, kind) in types.items()]))
    for name, values in columns.items():
        vertices[name] = values
    return "\n".join(header).encode("ascii") + vertices.tobytes() + faces.tobytes()


def decode_ply(data: bytes, source: str) -> AssetMesh:
    """The mesh of the bytes of a mesh.ply; further vertex properties are ignored.

    Raises `InputError` naming `source` where a property is missing, a face is not a triangle, or the data is truncated.
    """
    vertex_type, vertex_count, face_count, offset = _parse_header(data, source)
    missing = [name for name in _COLUMNS if name not in (vertex_type.names or ())]
    if missing:
        raise InputError(f"{source} lacks the vertex property {', '.join(missing)}; it needs {' '.join(_COLUMNS)}")
    needed = offset + vertex_count * vertex_type.itemsize + face_count * _FACE.itemsize
    if len(data) < needed:
        raise InputError(f"{source} ends after {len(data)} of {needed} bytes, or its faces are not all triangles")
    vertices = np.frombuffer(data, vertex_type, vertex_count, offset)
    faces = np.frombuffer(data, _FACE, face_count, offset + vertices.nbytes)
    if not (faces["count"] == 3).all():
        raise InputError(f"{source} has faces that are not triangles; triangulate it")
    with_tangents = all(name in (vertex_type.names or ()) for name in _TANGENT_COLUMNS)
    return AssetMesh(
        positions=_columns(vertices, "x", "y", "z"),
        normals=_columns(vertices, "nx", "ny", "nz"),
        uvs=_texture_coordinates(vertices),
        faces=np.ascontiguousarray(faces["corners"], dtype=np.int32),
        tangents=_columns(vertices, *_TANGENT_COLUMNS) if with_tangents else None,
    )


def _texture_coordinates(vertices: NDArray[np.void]) -> NDArray[np.float32]:
    with np.errstate(over="ignore"):  # as in `_columns`
        return flip_v(np.stack([vertices[name].astype(np.float64) for name in ("s", "t")], axis=1)).astype(np.float32)


def _columns(vertices: NDArray[np.void], *names: str) -> NDArray[np.float32]:
    with np.errstate(over="ignore"):  # doubles beyond float32 become infinite, which validate_asset reports
        return np.stack([vertices[name].astype(np.float32) for name in names], axis=1)


def _parse_header(data: bytes, source: str) -> tuple[np.dtype[np.void], int, int, int]:
    end = data.find(b"end_header", 0, 1 << 16)
    line_end = data.find(b"\n", end)
    if not data.startswith(b"ply") or end < 0 or line_end < 0:
        raise InputError(f"{source} is not a PLY file")
    counts: dict[str, int] = {}
    columns: list[tuple[str, str]] = []
    element, face_list = "", False
    for line in data[:end].decode("ascii", "replace").splitlines()[1:]:
        match line.split():
            case [] | ["comment", *_] | ["obj_info", *_]:
                continue
            case ["format", kind, _] if kind == "binary_little_endian":
                continue
            case ["element", ("vertex" | "face") as name, count] if count.isdecimal() and name not in counts:
                counts[name], element = int(count), name
            case ["property", kind, name] if element == "vertex" and kind in _SCALARS:
                columns.append((name, _SCALARS[kind]))
            case ["property", "list", "uchar" | "uint8", "int" | "int32" | "uint" | "uint32", _] if element == "face":
                face_list = True
            case _:
                raise InputError(f"{source} has the header line {line!r}, which a scene's mesh.ply cannot have")
    if list(counts) != ["vertex", "face"] or not face_list:
        raise InputError(f"{source} does not contain vertices followed by faces")
    try:
        vertex_type = np.dtype(columns)
    except ValueError as error:
        raise InputError(f"{source} defines a vertex property twice ({error})") from error
    return vertex_type, counts["vertex"], counts["face"], line_end + 1
