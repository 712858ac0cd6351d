"""The exported files that readers are tried on, and the made asset that they contain."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np
from hir_exporters.asset import Asset, AssetEnvironment, AssetMaterial, AssetMesh
from hir_exporters.errors import ExportError
from hir_exporters.format_options import GltfConfig, ObjConfig, UsdConfig, UsdzConfig
from hir_exporters.formats import create_exporter
from hir_exporters.textures.ktx2 import require_encoder

TEXTURE_SIDE: Final = 1024
"""Larger than the fallback beside WebP, so that its use is seen."""
PROFILES: Final = ("khr", "blender", "metalrough", "unity-legacy", "engine")


@dataclass(frozen=True)
class Variant:
    """One way to export the asset."""

    name: str
    """The options as they are written on the command line."""
    suffix: str
    config: Any
    hulls: str = ""
    """How the names of collision shapes begin or end; empty: the file has none."""

    @property
    def kind(self) -> str:
        """gltf, usd or obj."""
        return {"glb": "gltf", "obj": "obj"}.get(self.suffix, self.suffix if self.suffix == "gltf" else "usd")


def variants() -> Iterator[Variant]:
    """Every profile × format, and each option that changes a file's structure. Libraries that are missing: left out."""
    for suffix in ("glb", "gltf"):
        for profile in PROFILES:
            yield Variant(f"{suffix} --profile {profile}", suffix, GltfConfig(profile=profile))
    yield Variant("glb image_format=jpeg", "glb", GltfConfig(image_format="jpeg"))
    yield Variant("glb image_format=webp", "glb", GltfConfig(image_format="webp"))
    if _encodes_ktx2():
        yield Variant("glb image_format=ktx2", "glb", GltfConfig(image_format="ktx2"))
    yield Variant("glb --budget phone", "glb", GltfConfig(budget="phone"))
    yield Variant("glb quantize=true", "glb", GltfConfig(quantize=True))
    if find_spec("DracoPy"):
        yield Variant("glb compression=draco", "glb", GltfConfig(compression="draco"))
    if find_spec("meshopt"):
        yield Variant("glb compression=meshopt", "glb", GltfConfig(compression="meshopt"))
    yield Variant("glb image_based_light=true", "glb", GltfConfig(image_based_light=True))
    yield Variant("glb xmp=true", "glb", GltfConfig(xmp=True))
    yield Variant("glb lod_layout=msft_lod", "glb", GltfConfig(lods=(200,), lod_layout="msft_lod"))
    if find_spec("coacd"):
        yield Variant("glb collision=unreal", "glb", GltfConfig(collision="unreal", collision_hulls=4), "UCX_")
        yield Variant("glb collision=godot", "glb", GltfConfig(collision="godot", collision_hulls=4), "-convcolonly")
        yield Variant("usda collision=true", "usda", UsdConfig(collision=True, collision_hulls=4), "Hull_")
    for suffix in ("usda", "usdc"):
        for workflow in ("metallic", "specular"):
            yield Variant(f"{suffix} workflow={workflow}", suffix, UsdConfig(workflow=workflow))
    yield Variant("usda materialx=true", "usda", UsdConfig(materialx=True))
    yield Variant("usdz", "usdz", UsdzConfig())
    yield Variant("usdz thumbnail=true image_format=jpeg", "usdz", UsdzConfig(thumbnail=True, image_format="jpeg"))
    yield Variant("obj", "obj", ObjConfig())


def _encodes_ktx2() -> bool:
    """Whether node and the npm package ktx2-encoder are there."""
    try:
        require_encoder()
    except ExportError:
        return False
    return True


def export_variant(variant: Variant, asset: Asset, folder: Path) -> Path:
    """Writes the files into a folder of their own; returns the file to open."""
    destination = folder / variant.name.replace(" ", "_").replace("=", "_") / f"asset.{variant.suffix}"
    destination.parent.mkdir(parents=True)
    return create_exporter(variant.suffix, variant.config).write(asset, destination).files[0]


def made_asset() -> Asset:
    """A stretched sphere with base colour, roughness, metalness and normal map, not symmetric in any axis."""
    v, u = np.meshgrid(np.linspace(0, 1, 17), np.linspace(0, 1, 33), indexing="ij")
    polar, azimuth = v * np.pi, u * 2 * np.pi
    sphere = np.stack([np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)], axis=-1)
    radii = np.array([0.1, 0.2, 0.15])
    corner = np.arange(v.size).reshape(v.shape)
    a, b, c, d = (x.ravel() for x in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    positions = (sphere * radii + [0.02, 0.2, -0.03]).reshape(-1, 3)
    p, q, r = positions[faces].transpose(1, 0, 2)
    faces = faces[np.linalg.norm(np.cross(q - p, r - p), axis=1) > 1e-9]
    used, faces = np.unique(faces, return_inverse=True)
    normals = (sphere / radii).reshape(-1, 3)[used]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    uvs = np.stack([u, v], axis=-1).reshape(-1, 2)[used]
    return Asset(
        AssetMesh(positions[used], normals, uvs, faces.reshape(-1, 3)),
        _material(),
        AssetEnvironment(np.linspace(0.2, 1.0, 16 * 32 * 3).reshape(16, 32, 3)),
        {"source": "made by tools/readers"},
        "asset",
    )


def _material() -> AssetMaterial:
    row, column = (np.mgrid[:TEXTURE_SIDE, :TEXTURE_SIDE] + 0.5) / TEXTURE_SIDE
    base = np.stack([0.2 + 0.6 * row, 0.3 + 0.5 * column, 0.5 + 0 * row], axis=-1)
    slope = 0.2 * np.sin(8 * np.pi * row)
    normal = np.stack([slope, 0 * row, np.sqrt(1 - slope**2)], axis=-1)
    return AssetMaterial.metallic(base, (column > 0.5).astype(float), 0.1 + 0.4 * row, normal)
