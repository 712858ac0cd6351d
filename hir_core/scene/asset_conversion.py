"""Conversion between scenes (torch) and assets (numpy); the only link between torch and the exporters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from hir_exporters.asset import PAPER_SPECULAR_MAX, Asset, AssetEnvironment, AssetMaterial, AssetMesh, validate_asset
from hir_exporters.asset_lamp import AssetLamp
from hir_exporters.conventions import ALPHA_MIN
from hir_exporters.mesh.tangents import with_tangents
from hir_exporters.mesh.vertex_welding import weld
from numpy.typing import NDArray
from torch import Tensor

from hir_core.errors import StageError
from hir_core.scene.scene import CameraLamp, EnvironmentMap, Material, Mesh, Scene, Topology


def bake(scene: Scene, *, name: str = "asset", provenance: Mapping[str, Any] | None = None) -> Asset:
    """The scene as an asset in the same frame: one vertex for each pair of position and texture coordinate.

    With a normal map the mesh has tangents, and a vertex whose corners have different tangents is split. Albedos,
    roughness and light are clamped to the ranges of an asset (albedo at most 1, light not negative). Raises
    `StageError` for a scene without material and for textures without texture coordinates, `InputError` for NaN.
    """
    if scene.material is None:
        raise StageError("the scene has no material to bake; let the reflectance stage run")
    mesh = _bake_mesh(scene.mesh, _has_textures(scene.material))
    if scene.material.normal is not None:
        mesh = with_tangents(mesh)  # the tangent frames that the normal map was fitted in
    asset = Asset(
        mesh=mesh,
        material=_bake_material(scene.material),
        environment=None if scene.environment is None else _bake_environment(scene.environment),
        provenance=dict(provenance or {}),
        name=name,
    )
    validate_asset(asset)
    return asset


def scene_from_asset(asset: Asset, device: torch.device | str = "cpu") -> Scene:
    """The inverse of `bake`: equal positions become one vertex again; normals follow from the faces."""
    first, group = weld(asset.mesh.positions)
    faces = asset.mesh.faces.astype(np.int64)
    mesh = Mesh(
        positions=torch.from_numpy(asset.mesh.positions[first].copy()),
        topology=Topology(torch.from_numpy(group[faces]), torch.from_numpy(faces)),
        uvs=torch.from_numpy(asset.mesh.uvs.copy()),
    )
    material, light = asset.material, asset.environment
    environment = None
    if light is not None:
        rotation = torch.from_numpy(light.to_world.astype(np.float32))
        lamp = None
        if light.lamp is not None:
            sizes = np.float64(light.lamp.exponent), np.float64(light.lamp.radius)
            values = (light.lamp.intensity, light.lamp.offset, *sizes)
            lamp = CameraLamp(*(torch.tensor(value, dtype=torch.float32) for value in values))
        environment = EnvironmentMap(torch.from_numpy(light.radiance.copy()), rotation, light.frame, lamp)
    return Scene(
        mesh,
        Material(
            model=material.model,
            diffuse_albedo=torch.from_numpy(material.diffuse_albedo.copy()),
            specular_albedo=torch.from_numpy(material.specular_albedo.copy()),
            roughness=torch.from_numpy(material.roughness.copy()).unsqueeze(-1),
            normal=None if material.normal is None else torch.from_numpy(material.normal.copy()),
            observed=None if material.observed is None else torch.from_numpy(material.observed.copy()),
            metalness=None if material.metalness is None else torch.from_numpy(material.metalness.copy()).unsqueeze(-1),
            dielectric_f0=material.dielectric_f0,
        ),
        environment,
    ).to(device)


def _has_textures(material: Material) -> bool:
    maps = (material.diffuse_albedo, material.specular_albedo, material.roughness, material.normal, material.metalness)
    return any(m is not None and m.ndim == 3 for m in maps)


def _bake_mesh(mesh: Mesh, needs_uvs: bool) -> AssetMesh:
    faces = _numpy(mesh.faces)
    if mesh.uvs is None or mesh.topology.uv_faces is None:
        if needs_uvs:
            raise StageError("the material has textures but the mesh no texture coordinates; let the atlas stage run")
        uvs, uv_faces, uv_order = np.zeros((1, 2), np.float32), np.zeros_like(faces), faces
    else:
        uvs, uv_order = _numpy(mesh.uvs).astype(np.float32), _numpy(mesh.topology.uv_faces)
        first, group = weld(uvs)
        uvs, uv_faces = uvs[first], group[uv_order]
    pairs = faces.astype(np.int64) * len(uvs) + uv_faces
    distinct, corners = np.unique(pairs.reshape(-1), return_inverse=True)
    # in the order of the texture coordinates: a glTF file that was read has one for each vertex, and keeps its indices
    lowest = np.full(len(distinct), np.iinfo(np.int64).max)
    np.minimum.at(lowest, corners, uv_order.reshape(-1))
    order = np.argsort(lowest, kind="stable")
    number = np.empty(len(distinct), np.int64)
    number[order] = np.arange(len(distinct))
    position, uv = distinct[order] // len(uvs), distinct[order] % len(uvs)
    return AssetMesh(
        positions=_numpy(mesh.positions)[position].astype(np.float32),
        normals=_unit(_numpy(mesh.normals))[position],
        uvs=uvs[uv],
        faces=number[corners].reshape(faces.shape).astype(np.int32),
    )


def _bake_material(material: Material) -> AssetMaterial:
    limit = PAPER_SPECULAR_MAX if material.model == "paper" else 1.0
    roughness = _clamped(material.roughness, ALPHA_MIN, 1.0)
    if material.metalness is not None:
        return AssetMaterial.metallic(
            _clamped(material.base_color, 0.0, 1.0),
            _clamped(material.metalness, 0.0, 1.0)[..., 0],
            roughness[..., 0],
            None if material.normal is None else _unit(_numpy(material.normal)),
            None if material.observed is None else _numpy(material.observed),
            material.dielectric_f0,
        )
    return AssetMaterial(
        model=material.model,
        diffuse_albedo=_clamped(material.diffuse_albedo, 0.0, 1.0),
        specular_albedo=_clamped(material.specular_albedo, 0.0, limit),
        roughness=roughness[..., 0],
        normal=None if material.normal is None else _unit(_numpy(material.normal)),
        observed=None if material.observed is None else _numpy(material.observed),
    )


def _bake_environment(environment: EnvironmentMap) -> AssetEnvironment:
    rotation = np.eye(3) if environment.to_world is None else _numpy(environment.to_world).astype(np.float64)
    lamp = None
    if environment.lamp is not None:
        found = environment.lamp
        intensity, offset = (_numpy(value).astype(np.float64) for value in (found.intensity, found.offset))
        lamp = AssetLamp(np.maximum(intensity, 0), offset, float(found.exponent), float(found.radius))
    return AssetEnvironment(_clamped(environment.radiance, 0.0, np.inf), rotation, environment.frame, lamp)


def _clamped(values: Tensor, low: float, high: float) -> NDArray[np.float32]:
    return np.clip(_numpy(values).astype(np.float32), np.float32(low), np.float32(high))


def _unit(vectors: NDArray[np.floating]) -> NDArray[np.float32]:
    """Unit vectors in float32; one of length 0 (a folded vertex, a blurred map) becomes +Y in a mesh, +Z in a map."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    up = np.zeros_like(vectors)
    up[..., 2 if vectors.ndim == 3 else 1] = 1
    return np.asarray(np.where(length > 1e-12, vectors / np.maximum(length, 1e-12), up), dtype=np.float32)


def _numpy(tensor: Tensor) -> NDArray[Any]:
    return np.asarray(tensor.detach().cpu().numpy())
