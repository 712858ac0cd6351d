"""Which texture coordinates a USD mesh has for the textures of its material."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.errors import InputError

if TYPE_CHECKING:
    from pxr import UsdGeom, UsdShade

_ROLE_TYPES: Final = ("texCoord2f[]", "texCoord2d[]", "texCoord2h[]")
_PLAIN_TYPES: Final = ("float2[]", "double2[]", "half2[]")
_USUAL_NAME: Final = "st"
_MAX_TRANSFORMS: Final = 100


@dataclass(frozen=True)
class TextureCoordinates:
    """The primvar that a texture reads, and what its nodes apply to it."""

    primvar: str | None = None
    """None where the material names none."""
    matrix: tuple[tuple[float, float], tuple[float, float]] = ((1.0, 0.0), (0.0, 1.0))
    """For row vectors with the origin at the bottom left."""
    offset: tuple[float, float] = (0.0, 0.0)

    def applied(self, uvs: NDArray[np.float64]) -> NDArray[np.float64]:
        if self == TextureCoordinates(self.primvar):
            return uvs
        return uvs @ np.asarray(self.matrix) + self.offset


def coordinates_of_texture(texture: UsdShade.Shader, path: Path) -> TextureCoordinates:
    """What the input `st` of a UsdUVTexture reads through UsdTransform2d and UsdPrimvarReader_float2.

    Raises `InputError` for other nodes.
    """
    from hir_exporters.reading.usd_reading.shader_inputs import connected_node, input_value

    matrix, offset, node, name = np.eye(2), np.zeros(2), texture, "st"
    for _ in range(_MAX_TRANSFORMS):
        source, _ = connected_node(node, name, path)
        if source is None:
            return TextureCoordinates(None, _pairs(matrix), _pair(offset))
        node, kind = source, source.GetIdAttr().Get()
        if str(kind).startswith("UsdPrimvarReader"):
            primvar = input_value(node, "varname", path)
            return TextureCoordinates(None if not primvar else str(primvar), _pairs(matrix), _pair(offset))
        if kind != "UsdTransform2d":
            break
        # The node that is nearer to the primvar is applied first.
        angle = np.radians(float(input_value(node, "rotation", path, 0.0)))
        rotation = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        own = np.diag(np.asarray(input_value(node, "scale", path, (1, 1)), np.float64)) @ rotation
        offset = np.asarray(input_value(node, "translation", path, (0, 0)), np.float64) @ matrix + offset
        matrix, name = own @ matrix, "in"
    raise InputError(
        f"{path}: {node.GetPath()} ({node.GetIdAttr().Get()}) makes texture coordinates in a way that is not read; "
        "bake the texture first"
    )


def common_coordinates(found: set[TextureCoordinates], path: Path) -> TextureCoordinates:
    """The coordinates of all textures of a material. Raises `InputError` where they differ."""
    if len(found) > 1:
        names = ", ".join(sorted({repr(one.primvar) for one in found}))
        raise InputError(
            f"{path}: textures of its material have different texture coordinates or transforms (primvars {names}); "
            "bake them to one set first"
        )
    return found.pop() if found else TextureCoordinates()


def chosen_primvar(mesh: UsdGeom.Mesh, coordinates: TextureCoordinates, path: Path) -> UsdGeom.Primvar:
    """The primvar that the material names, else `st`, else the only one with texture coordinates."""
    from pxr import UsdGeom

    primvars = UsdGeom.PrimvarsAPI(mesh)
    if coordinates.primvar is not None:
        primvar = primvars.FindPrimvarWithInheritance(coordinates.primvar)
        if primvar and primvar.HasValue():
            return primvar
    found = {primvar.GetPrimvarName(): primvar for primvar in _coordinate_sets(primvars)}
    if not found:
        raise InputError(f"{path}: mesh.uvs is missing; unwrap the mesh first")
    names = ", ".join(sorted(found))
    if coordinates.primvar is not None:
        raise InputError(
            f"{path}: textures of its material read the primvar {coordinates.primvar!r}, which the mesh "
            f"{mesh.GetPath()} lacks; it has {names}: rename it there"
        )
    if _USUAL_NAME in found:
        return found[_USUAL_NAME]
    if len(found) > 1:
        raise InputError(
            f"{path}: the mesh {mesh.GetPath()} has several texture coordinates ({names}), and its material names "
            f"none; rename one to {_USUAL_NAME!r}"
        )
    return next(iter(found.values()))


def _coordinate_sets(primvars: UsdGeom.PrimvarsAPI) -> list[UsdGeom.Primvar]:
    """Primvars of the type of texture coordinates, else those of two numbers, which older files have."""
    valued = primvars.GetPrimvarsWithValues()
    for types in (_ROLE_TYPES, _PLAIN_TYPES):
        if found := [primvar for primvar in valued if str(primvar.GetTypeName()) in types]:
            return found
    return []


def _pairs(matrix: NDArray[np.float64]) -> tuple[tuple[float, float], tuple[float, float]]:
    return _pair(matrix[0]), _pair(matrix[1])


def _pair(values: NDArray[np.float64]) -> tuple[float, float]:
    return float(values[0]), float(values[1])
