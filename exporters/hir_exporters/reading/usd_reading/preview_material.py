"""The one material of a USD file: which it is, and its UsdPreviewSurface as a surface."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hir_exporters.errors import InputError
from hir_exporters.materials.surfaces import MetallicSurface, SpecularSurface, default_surface
from hir_exporters.reading.readback import index_of_refraction
from hir_exporters.reading.usd_reading.mesh_corners import polygon_count
from hir_exporters.reading.usd_reading.shader_inputs import connected_node, input_value
from hir_exporters.reading.usd_reading.shader_textures import texture_values
from hir_exporters.reading.usd_reading.texture_coordinates import (
    TextureCoordinates,
    common_coordinates,
    coordinates_of_texture,
)

if TYPE_CHECKING:
    from pxr import UsdGeom, UsdShade

_COLORS: Final = ("diffuseColor", "specularColor", "emissiveColor")
_LEFT_OUT: Final = {"opacity": 1.0, "emissiveColor": 0.0, "clearcoat": 0.0, "displacement": 0.0, "occlusion": 1.0}
"""Inputs that an asset has no place for, with the value that has no effect."""
_CODE_STEP: Final = 1 / 255


@dataclass(frozen=True)
class PreviewMaterial:
    """A material, and the texture coordinates that its textures read."""

    surface: MetallicSurface
    specular_surface: SpecularSurface | None
    normal: NDArray[np.float32] | None
    coordinates: TextureCoordinates
    wraps: frozenset[str]
    """What its textures do outside of 0 to 1, in UsdUVTexture's words."""


def bound_material(meshes: Sequence[UsdGeom.Mesh], path: Path) -> UsdShade.Material | None:
    """The material of all faces, also where it is bound by subsets; None where there is none.

    Raises `InputError` for several. Warns where only some faces have a material.
    """
    from pxr import UsdShade

    materials, without = {}, False
    for mesh in meshes:
        subsets = UsdShade.MaterialBindingAPI(mesh).GetMaterialBindSubsets()
        prims = [subset.GetPrim() for subset in subsets if len(subset.GetIndicesAttr().Get() or ())]
        covered = {index for subset in subsets for index in subset.GetIndicesAttr().Get() or ()}
        if len(covered) < polygon_count(mesh):
            prims.append(mesh.GetPrim())
        for prim in prims:
            material = _material_of(prim)
            if material is None:
                without = True
            else:
                materials[_identity(material)] = material
    if len(materials) > 1:
        raise InputError(f"{path} has {len(materials)} materials; an asset has one: merge them first")
    if materials and without:
        warnings.warn(
            f"{path} has faces without a material, which get that of the others; bind a material to them first",
            stacklevel=3,
        )
    return next(iter(materials.values()), None)


def _material_of(prim: object) -> UsdShade.Material | None:
    """The material for previews, which a binding for all purposes gives too, else that for final renders."""
    from pxr import UsdShade

    for purpose in (UsdShade.Tokens.preview, UsdShade.Tokens.full):
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial(purpose)
        if material:
            return material
    return None


def _identity(material: UsdShade.Material) -> str:
    """The path of a material; that in the prototype for those of instances."""
    prim = material.GetPrim()
    return str(prim.GetPrimInPrototype().GetPath() if prim.IsInstanceProxy() else prim.GetPath())


def read_material(material: UsdShade.Material | None, path: Path) -> PreviewMaterial:
    """The UsdPreviewSurface of a material, or the default surface. Warns of inputs that an asset has not.

    Raises `InputError` for other shaders.
    """
    if material is None:
        return PreviewMaterial(default_surface(), None, None, TextureCoordinates(), frozenset())
    shader = material.ComputeSurfaceSource()[0]
    if not shader or shader.GetIdAttr().Get() != "UsdPreviewSurface":
        raise InputError(f"{path}: the material {material.GetPath()} has no UsdPreviewSurface; export it with one")
    coordinates: set[TextureCoordinates] = set()
    wraps: set[str] = set()

    def value(name: str, default: ArrayLike, used: bool = True) -> NDArray[np.floating]:
        node, output = connected_node(shader, name, path)
        if node is None:
            return np.asarray(input_value(shader, name, path, default), np.float32)
        values = texture_values(node, output, name in _COLORS, path)
        if used:
            coordinates.add(coordinates_of_texture(node, path))
            wraps.update(str(input_value(node, axis, path)) for axis in ("wrapS", "wrapT"))
        width = np.ndim(default)
        if values.ndim == 2 + width:
            return values
        if not width:
            raise InputError(f"{path}: {name} of its material is connected to {output}; connect it to one channel")
        return np.repeat(values[..., None], 3, axis=2)

    roughness = value("roughness", 0.5)
    ior = value("ior", 1.5)
    if ior.ndim:
        raise InputError(f"{path}: ior of its material is a texture; set it to a number")
    surface = MetallicSurface(
        value("diffuseColor", [0.18] * 3),
        value("metallic", 0.0),
        roughness,
        np.ones((), np.float32),
        np.ones(3, np.float32),
        index_of_refraction(float(ior), path),
        residual=0.0,
    )
    specular_surface = None
    if int(value("useSpecularWorkflow", 0)):
        specular = value("specularColor", [0.0] * 3)
        specular_surface = SpecularSurface(surface.base_color, specular, roughness, residual=0.0)
    normal = value("normal", [0.0, 0.0, 1.0])
    left_out = [
        name
        for name, neutral in _LEFT_OUT.items()
        if np.any(np.abs(value(name, [neutral] * 3 if name in _COLORS else neutral, used=False) - neutral) > _CODE_STEP)
    ]
    if normal.ndim == 1 and not np.array_equal(normal, [0, 0, 1]):
        left_out.append("normal")
    if left_out:
        verb = "is" if len(left_out) == 1 else "are"
        warnings.warn(
            f"{path}: {' and '.join(left_out)} of its material {verb} left out, because an asset has no such property; "
            "set them again in the program that reads the result",
            stacklevel=3,
        )
    if normal.ndim == 3 and normal.min() >= 0:
        warnings.warn(
            f"{path}: its normal map has no negative number; give its UsdUVTexture a scale of 2 and a bias of -1",
            stacklevel=3,
        )
    return PreviewMaterial(
        surface,
        specular_surface,
        normal.astype(np.float32) if normal.ndim == 3 else None,
        common_coordinates(coordinates, path),
        frozenset(wraps),
    )
