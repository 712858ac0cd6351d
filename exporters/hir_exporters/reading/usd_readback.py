"""Reads an exported .usda, .usdc or .usdz with pxr."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hir_exporters.errors import InputError
from hir_exporters.materials.surfaces import MetallicSurface, SpecularSurface
from hir_exporters.reading.readback import ReadBack, index_of_refraction
from hir_exporters.reading.texture_decoding import decoded_pixels, linear_color, unit_values
from hir_exporters.reading.usd_containment import check_inside, check_layers
from hir_exporters.usd_library import require_usd

if TYPE_CHECKING:
    from pxr import UsdShade


def read_usd(path: Path) -> ReadBack:
    """A .usda, .usdc or .usdz with one mesh and one UsdPreviewSurface. Raises `InputError` naming the file."""
    from pxr import Usd, UsdGeom, UsdPhysics, UsdShade

    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path} does not exist")
    require_usd(path, InputError)
    try:
        check_layers(path)
        stage = Usd.Stage.Open(str(path))
        shapes = UsdPhysics.CollisionAPI
        meshes = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh) and not prim.HasAPI(shapes)]
        if len(meshes) != 1:
            raise InputError(f"{path} contains {len(meshes)} meshes; an exported file has one")
        mesh = UsdGeom.Mesh(meshes[0])
        faces = np.asarray(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
        st = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
        uvs = _by_corner(st.ComputeFlattened(), st.GetInterpolation(), faces) * [1, -1] + [0, 1]
        material, _ = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()
        shader, *_ = material.ComputeSurfaceSource()
        surface, specular_surface, normal = _usd_material(UsdShade.Shader(shader), path)
        positions = _by_corner(mesh.GetPointsAttr().Get(), "vertex", faces)
        normals = _by_corner(mesh.GetNormalsAttr().Get(), mesh.GetNormalsInterpolation(), faces)
        return ReadBack(positions, normals, uvs, surface, specular_surface, normal)
    except InputError:
        raise
    except Exception as error:  # OpenUSD's errors, and those of decoding broken text
        raise InputError(f"{path} cannot be read back as USD ({_one_line(error)})") from error


def _by_corner(values: ArrayLike, interpolation: str, faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Values (F, 3, C) of corners from values of points or of corners."""
    array = np.asarray(values, np.float64)
    return array.reshape(*faces.shape, -1) if interpolation == "faceVarying" else array[faces]


def _one_line(error: Exception) -> str:
    """Type and message on one line. OpenUSD quotes content of broken files that may not be valid text."""
    try:
        return f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"
    except UnicodeDecodeError:
        return type(error).__name__


def _usd_material(
    shader: UsdShade.Shader, path: Path
) -> tuple[MetallicSurface, SpecularSurface | None, NDArray[np.float32] | None]:
    def value(name: str, default: ArrayLike) -> NDArray[np.floating]:
        source = shader.GetInput(name)
        if not source:
            return np.asarray(default, np.float32)
        if not source.HasConnectedSource():
            return np.asarray(source.Get(), np.float32)
        connection, channel, _ = source.GetConnectedSource()
        return _usd_texture(connection, str(channel), path)

    white, black = [1.0] * 3, [0.0] * 3
    roughness = value("roughness", 0.5)
    surface = MetallicSurface(
        value("diffuseColor", [0.18] * 3),
        value("metallic", 0.0),
        roughness,
        np.ones((), np.float32),
        np.asarray(white, np.float32),
        index_of_refraction(float(value("ior", 1.5)), path),
        residual=0.0,
    )
    specular_surface = None
    if int(value("useSpecularWorkflow", 0)):
        specular_surface = SpecularSurface(surface.base_color, value("specularColor", black), roughness, residual=0.0)
    normal = value("normal", [0.0, 0.0, 1.0])
    return surface, specular_surface, normal.astype(np.float32) if normal.ndim == 3 else None


def _usd_texture(connection: UsdShade.ConnectableAPI, channel: str, path: Path) -> NDArray[np.floating]:
    from pxr import Ar, UsdShade

    node = UsdShade.Shader(connection.GetPrim())
    file = node.GetInput("file").Get()
    check_inside(path, file.resolvedPath, file.path)
    asset = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(file.resolvedPath))
    image = decoded_pixels(bytes(asset.GetBuffer()))
    chosen = slice(0, 3) if channel == "rgb" else slice("rgba".index(channel), "rgba".index(channel) + 1)
    scale, bias = node.GetInput("scale"), node.GetInput("bias")
    decode = linear_color if node.GetInput("sourceColorSpace").Get() == "sRGB" else unit_values
    values = decode(image[..., chosen])
    if scale:
        factor, offset = (np.asarray(part.Get(), np.float32)[chosen] for part in (scale, bias))
        if (factor != 1).any():
            values *= factor
        if offset.any():
            values += offset
    return np.asarray(values if channel == "rgb" else values[..., 0])
