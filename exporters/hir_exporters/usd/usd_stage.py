"""An asset as a USD stage: one mesh, one UsdPreviewSurface, metres and +Y up."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from hir_exporters.asset import Asset, AssetMesh
from hir_exporters.conventions import flip_v
from hir_exporters.mesh.unit_vectors import unit_vectors
from hir_exporters.mesh.vertex_welding import weld
from hir_exporters.textures.texture_maps import sample_texels
from hir_exporters.usd.preview_surface import UsdSurface, add_material

if TYPE_CHECKING:
    from pxr import Usd


def build_stage(
    asset: Asset, surface: UsdSurface, textures: Mapping[str, str], meters_per_unit: float, subsets: bool = False
) -> Usd.Stage:
    """A stage in memory; `textures` gives the asset path of each image of the surface by its name.

    `subsets` names the faces that some view saw and those that none did, where the material knows (`observed`).
    """
    from pxr import Kind, Sdf, Usd, UsdGeom, UsdShade

    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, meters_per_unit)
    root = Sdf.Path("/" + prim_name(asset.name))
    prim = UsdGeom.Xform.Define(stage, root).GetPrim()
    Usd.ModelAPI(prim).SetKind(Kind.Tokens.component)
    stage.SetDefaultPrim(prim)
    if asset.provenance:
        prim.SetCustomDataByKey("hir", _custom_data(asset.provenance))
    mesh = _add_mesh(asset, stage, root.AppendChild("Geometry"))
    if subsets:
        _add_subsets(asset, mesh)
    material = add_material(surface, stage, root.AppendChild("Material"), textures)
    UsdShade.MaterialBindingAPI.Apply(mesh).Bind(material)
    return stage


def prim_name(name: str) -> str:
    """A valid prim name that looks like `name`."""
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    return plain if re.match(r"[A-Za-z_]", plain) else f"_{plain}"


def _add_mesh(asset: Asset, stage: Usd.Stage, path: Any) -> Any:
    """Seams of the texture are not those of the surface: equal points with one normal are one, corners have UVs."""
    from pxr import UsdGeom, Vt

    mesh = UsdGeom.Mesh.Define(stage, path)
    data = asset.mesh
    normals = unit_vectors(data.normals)
    first, point = weld(np.concatenate([data.positions, normals], axis=1))
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(data.positions[first]))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(data.faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(point[data.faces].astype(np.int32).reshape(-1)))
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals[first]))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateOrientationAttr(UsdGeom.Tokens.rightHanded)
    mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(mesh.GetPointsAttr().Get()))
    _add_uvs(data, mesh, len(first) < len(point))
    return mesh.GetPrim()


def _add_uvs(data: AssetMesh, mesh: Any, seams: bool) -> None:
    """`st` by corner where points have several, else by point; what repeats is indexed."""
    from pxr import Sdf, UsdGeom, Vt

    uvs = flip_v(data.uvs).astype(np.float32)
    first, index = weld(uvs)
    kind = UsdGeom.Tokens.faceVarying if seams else UsdGeom.Tokens.vertex
    st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, kind)
    if seams or len(first) < len(uvs):
        used = index[data.faces] if seams else index
        st.SetIndices(Vt.IntArray.FromNumpy(used.astype(np.int32).reshape(-1)))
        uvs = uvs[first]
    st.Set(Vt.Vec2fArray.FromNumpy(uvs))


def _add_subsets(asset: Asset, mesh: Any) -> None:
    """A face counts as seen where the texel at its middle is; nothing is added where all or none are."""
    from pxr import UsdGeom, Vt

    if asset.material.observed is None:
        return
    middles = asset.mesh.uvs[asset.mesh.faces].mean(axis=1).astype(np.float64) % 1.0
    seen = sample_texels(asset.material.observed.astype(np.float32), False, middles) > 0.5
    if seen.all() or not seen.any():
        return
    for name, faces in (("observed", np.flatnonzero(seen)), ("unobserved", np.flatnonzero(~seen))):
        indices = Vt.IntArray.FromNumpy(faces.astype(np.int32))
        UsdGeom.Subset.CreateGeomSubset(
            UsdGeom.Mesh(mesh), name, UsdGeom.Tokens.face, indices, "observation", UsdGeom.Tokens.partition
        )


def _custom_data(value: Any) -> Any:
    """JSON-able values as USD's dictionaries hold them: lists and null have no type there and become JSON text."""
    import json

    if isinstance(value, Mapping):
        return {re.sub(r"[^\w]", "_", str(key)): _custom_data(entry) for key, entry in value.items()}
    if isinstance(value, bool | str | float):
        return value
    if isinstance(value, int) and abs(value) < 2**31:
        return value
    return json.dumps(value, sort_keys=True)
