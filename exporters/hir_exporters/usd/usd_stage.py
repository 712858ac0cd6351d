"""Builds a USD stage of an asset: one mesh and one UsdPreviewSurface, +Y up."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from hir_exporters.asset import Asset, AssetMesh
from hir_exporters.asset_lamp import described_provenance
from hir_exporters.conventions import flip_v
from hir_exporters.mesh.unit_vectors import unit_vectors
from hir_exporters.mesh.vertex_welding import weld
from hir_exporters.textures.texture_maps import sample_texels
from hir_exporters.usd.preview_surface import UsdSurface, add_material

if TYPE_CHECKING:
    from pxr import Sdf, Usd, UsdGeom


def build_stage(
    asset: Asset, surface: UsdSurface, textures: Mapping[str, str], meters_per_unit: float, subsets: bool = False
) -> Usd.Stage:
    """A stage in memory; `textures` maps the name of each image of the surface to its asset path.

    `subsets` adds face subsets for observed and unobserved faces, where the material has `observed`.
    """
    from pxr import Kind, Sdf, Usd, UsdGeom, UsdShade

    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, meters_per_unit)
    root = Sdf.Path("/" + prim_name(asset.name))
    prim = UsdGeom.Xform.Define(stage, root).GetPrim()
    Usd.ModelAPI(prim).SetKind(Kind.Tokens.component)
    stage.SetDefaultPrim(prim)
    if provenance := described_provenance(asset.provenance, asset.lamp):
        prim.SetCustomDataByKey("hir", _custom_data(provenance))
    mesh = _add_mesh(asset, stage, root.AppendChild("Geometry"))
    if subsets:
        _add_subsets(asset, mesh)
    material = add_material(surface, stage, root.AppendChild("Material"), textures)
    UsdShade.MaterialBindingAPI.Apply(mesh).Bind(material)
    return stage


def prim_name(name: str) -> str:
    """`name` as a valid prim name: other characters than ASCII letters, digits and _ are replaced by _."""
    valid = re.sub(r"\W", "_", name, flags=re.ASCII)
    return valid if re.match(r"[A-Za-z_]", valid) else f"_{valid}"


def _add_mesh(asset: Asset, stage: Usd.Stage, path: Sdf.Path) -> Usd.Prim:
    """Adds the mesh. Vertices that differ only in UV are one point, and UVs are written for each corner."""
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


def _add_uvs(data: AssetMesh, mesh: UsdGeom.Mesh, seams: bool) -> None:
    """Adds the primvar `st` for each corner where points have several UVs, else for each point; repeats are indexed."""
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


def _add_subsets(asset: Asset, mesh: Usd.Prim) -> None:
    """Adds the subsets. A face is observed if the texel at its centre is. All or none observed: adds nothing."""
    from pxr import UsdGeom, Vt

    if asset.material.observed is None:
        return
    centers = asset.mesh.uvs[asset.mesh.faces].mean(axis=1).astype(np.float64) % 1.0
    observed = sample_texels(asset.material.observed.astype(np.float32), False, centers) > 0.5
    if observed.all() or not observed.any():
        return
    for name, faces in (("observed", np.flatnonzero(observed)), ("unobserved", np.flatnonzero(~observed))):
        indices = Vt.IntArray.FromNumpy(faces.astype(np.int32))
        UsdGeom.Subset.CreateGeomSubset(
            UsdGeom.Mesh(mesh), name, UsdGeom.Tokens.face, indices, "observation", UsdGeom.Tokens.partition
        )


def _custom_data(value: object) -> object:
    """JSON values for USD's dictionaries; lists and null, which have no type there, become JSON text."""
    import json

    if isinstance(value, Mapping):
        return {re.sub(r"[^\w]", "_", str(key)): _custom_data(entry) for key, entry in value.items()}
    if isinstance(value, bool | str | float):
        return value
    if isinstance(value, int) and abs(value) < 2**31:
        return value
    return json.dumps(value, sort_keys=True)
