"""The corners `v/vt/vn` of the faces of an .obj as indices."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.errors import InputError
from hir_exporters.reading.wavefront.obj_statements import Statements

NAMES: Final = ("v", "vt", "vn")

_MAX_DIGITS: Final = 18  # of a 64-bit integer
_FACES_PER_CHUNK: Final = 100_000
_SLASH, _NEWLINE, _SPACE = ord("/"), ord("\n"), ord(" ")


@dataclass(frozen=True, eq=False)
class FaceCorners:
    """Corners of polygons, those of one face after those of another."""

    indices: NDArray[np.int64]
    """(C, 3), indices from 0 into the positions, texture coordinates and normals; -1 where a corner has none."""
    sizes: NDArray[np.int64]
    """(F,), the corners of each face."""


def read_corners(path: Path, faces: Statements, vertex_lines: tuple[list[int], list[int], list[int]]) -> FaceCorners:
    """Corners of all faces; `vertex_lines` are the lines of the statements v, vt and vn.

    Negative indices count backwards from the face. Without any vt no corner has a texture coordinate. Raises
    `InputError` with the line where a corner is malformed, or has an index that no statement defines.
    """
    lines, vertices = np.array(faces.lines, np.int64), [np.array(lines, np.int64) for lines in vertex_lines]
    parts, sizes = [np.zeros((0, 3), np.int64)], [np.zeros(0, np.int64)]
    for start in range(0, len(lines), _FACES_PER_CHUNK):
        chunk = slice(start, start + _FACES_PER_CHUNK)
        written, count = _written_indices(path, faces.arguments[chunk], lines[chunk])
        parts.append(_resolved(path, written, np.repeat(lines[chunk], count), vertices))
        sizes.append(count)
    return FaceCorners(np.concatenate(parts), np.concatenate(sizes))


def _written_indices(
    path: Path, arguments: list[bytes], lines: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices (C, 3) as the file has them, 0 where there is none, and the corners of each face."""
    if any(b"#" in argument for argument in arguments):
        arguments = [argument.partition(b"#")[0] for argument in arguments]
    text = b"\n".join(argument.translate(_BLANKS) for argument in arguments) + b"\n"
    code = np.frombuffer(text, np.uint8)
    blank, slash = (code == _SPACE) | (code == _NEWLINE), code == _SLASH
    line = np.cumsum(code == _NEWLINE, dtype=np.int32)

    def refuse(where: NDArray[np.bool_], reason: str) -> None:
        if where.any():
            number = lines[line[int(where.argmax())]]
            raise InputError(f"{path} has a face in line {number} that {reason}; export it again")

    digit = (code >= ord("0")) & (code <= ord("9"))
    sign = (code == ord("-")) | (code == ord("+"))
    following = np.append(digit[1:], False)
    before = np.append(True, blank[:-1] | slash[:-1])  # the first character of a number follows one of these
    refuse(~(digit | sign | blank | slash) | (sign & ~(following & before)), "is not a list of corners v/vt/vn")
    corner_begins = ~blank & np.append(True, blank[:-1])
    number_begins, number_ends = np.flatnonzero((digit | sign) & before), np.flatnonzero(digit & ~following)
    long = np.zeros(len(code), bool)
    long[number_begins[number_ends - number_begins > _MAX_DIGITS]] = True
    refuse(long, "has an index of too many digits")
    corner = np.cumsum(corner_begins, dtype=np.int32) - 1
    slashes = np.cumsum(slash, dtype=np.int32)
    first = np.flatnonzero(corner_begins)
    column = slashes - (slashes - slash)[first][corner] if len(first) else slashes
    refuse(slash & (column > 2), "has a corner of more than three indices")
    indices = np.zeros((len(first), 3), np.int64)
    # numpy makes a number of an empty text
    values = np.fromstring(text.translate(_SEPARATORS) if len(number_begins) else b"0", np.int64, sep=" ")
    values = values[: len(number_begins)]
    indices[corner[number_begins], column[number_begins]] = values
    zero, no_position = np.zeros(len(code), bool), np.zeros(len(code), bool)
    zero[number_begins[values == 0]] = True
    refuse(zero, "has the index 0, and they count from 1")
    no_position[first[indices[:, 0] == 0]] = True
    refuse(no_position, "has a corner without a position")
    return indices, np.bincount(line[first], minlength=len(arguments)).astype(np.int64)


def _resolved(
    path: Path, written: NDArray[np.int64], lines: NDArray[np.int64], vertices: list[NDArray[np.int64]]
) -> NDArray[np.int64]:
    """Indices from 0, -1 for none; `lines` are those of the corners."""
    resolved = written - 1  # 0, which means none, becomes -1
    for column, defined in enumerate(vertices):
        if NAMES[column] == "vt" and not len(defined):
            resolved[:, column] = -1  # no texture coordinates at all: an error where a reader needs them
            continue
        values = written[:, column]
        relative = values < 0
        if relative.any():
            resolved[relative, column] = np.searchsorted(defined, lines[relative]) + values[relative]
        wrong = (values != 0) & ((resolved[:, column] < 0) | (resolved[:, column] >= len(defined)))
        if wrong.any():
            corner = int(wrong.argmax())
            raise InputError(
                f"{path}: mesh.faces has an index out of range in line {lines[corner]}, {NAMES[column]} "
                f"{values[corner]} of {len(defined)}; export the mesh again"
            )
    return resolved


_BLANKS: Final = bytes.maketrans(b"\t\v\f\r\n", b"     ")
_SEPARATORS: Final = bytes.maketrans(b"/\n", b"  ")
