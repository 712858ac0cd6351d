"""A box of quads as another program writes it: texture coordinates and normals of corners, and one picture."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from hir_exporters.textures.png_encoding import png_bytes
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade

SIZE = np.array([1.0, 2.0, 3.0])
POINTS = [(x * 1.0, y * 2.0, z * 3.0) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
NORMALS = [(-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1)]
ST = [(0, 0), (1, 0), (1, 1), (0, 1)] * 6
COLOR = (200, 100, 50)
"""sRGB codes of the picture."""


def write_box(folder: Path, edit: Callable[[Usd.Stage], object] = lambda stage: None) -> Path:
    """The file after `edit` of its stage: /Root/Box, /Root/Material/Surface and its texture /Root/Material/Color."""
    (folder / "color.png").write_bytes(png_bytes(np.full((2, 2, 3), COLOR, np.uint8)))
    stage = Usd.Stage.CreateNew(str(folder / "box.usda"))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Root").GetPrim())
    material = UsdShade.Material.Define(stage, "/Root/Material")
    surface = UsdShade.Shader.Define(stage, "/Root/Material/Surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    connect_texture(stage, "diffuseColor", "rgb")
    add_box(stage)
    edit(stage)
    stage.Save()
    return folder / "box.usda"


def add_box(stage: Usd.Stage, prim: str = "/Root/Box", offset: float = 0.0) -> UsdGeom.Mesh:
    mesh = UsdGeom.Mesh.Define(stage, prim)
    mesh.CreatePointsAttr([(x + offset, y, z) for x, y, z in POINTS])
    mesh.CreateFaceVertexCountsAttr([4] * 6)
    mesh.CreateFaceVertexIndicesAttr([corner for quad in QUADS for corner in quad])
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.CreateNormalsAttr([normal for normal in NORMALS for _ in range(4)])
    mesh.SetNormalsInterpolation("faceVarying")
    st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "faceVarying")
    st.Set(ST)
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(UsdShade.Material.Get(stage, "/Root/Material"))
    return mesh


def box_of(stage: Usd.Stage) -> UsdGeom.Mesh:
    return UsdGeom.Mesh.Get(stage, "/Root/Box")


def surface_of(stage: Usd.Stage) -> UsdShade.Shader:
    return UsdShade.Shader.Get(stage, "/Root/Material/Surface")


def texture_of(stage: Usd.Stage) -> UsdShade.Shader:
    return UsdShade.Shader.Get(stage, "/Root/Material/Color")


def connect_texture(stage: Usd.Stage, name: str, channel: str, prim: str = "Color") -> UsdShade.Shader:
    """Connects an input of the surface with a UsdUVTexture of the picture."""
    types = Sdf.ValueTypeNames
    kind = types.Float if channel != "rgb" else types.Normal3f if name == "normal" else types.Color3f
    texture = UsdShade.Shader.Define(stage, f"/Root/Material/{prim}")
    texture.CreateIdAttr("UsdUVTexture")
    texture.CreateInput("file", types.Asset).Set("./color.png")
    texture.CreateOutput(channel, types.Float3 if channel == "rgb" else types.Float)
    surface_of(stage).CreateInput(name, kind).ConnectToSource(texture.ConnectableAPI(), channel)
    return texture


def read_coordinates(stage: Usd.Stage, varname: str) -> UsdShade.Shader:
    """Lets the texture read a primvar; returns the UsdPrimvarReader_float2."""
    reader = UsdShade.Shader.Define(stage, "/Root/Material/Reader")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set(varname)
    reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
    texture_of(stage).CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
    return reader


def volume(positions: NDArray[np.float64]) -> float:
    """Signed volume of closed triangles (F, 3, 3): positive where they are counter-clockwise from outside."""
    return float(np.linalg.det(positions).sum() / 6)


def transform(stage: Usd.Stage, prim: str, *rows: tuple[float, float, float, float]) -> None:
    """Sets the transform of a prim to the matrix with these rows, for row vectors."""
    UsdGeom.Xformable(stage.GetPrimAtPath(prim)).AddTransformOp().Set(Gf.Matrix4d(rows))
