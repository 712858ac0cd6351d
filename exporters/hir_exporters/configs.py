"""Options of each file format, light enough to be imported by a plugin's descriptor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class GltfConfig:
    """Options of .glb and .gltf."""

    profile: Literal["khr", "blender", "metalrough", "unity-legacy"] = "khr"
    """How the material is said: for readers of the ratified extensions, for Blender, for core readers, for glTFast."""
    budget: Literal["none", "quicklook", "web", "desktop"] = "none"
    """Bounds of a target: what has more triangles or larger textures is reduced, and the report says so."""
    max_texture_size: int = 4096
    """Larger textures are reduced to this many pixels a side."""
    image_format: Literal["png", "jpeg", "ktx2"] = "png"
    """JPEG is smaller and loses detail; normal maps and alpha stay PNG. KTX2 is refused, with what to do instead."""
    jpeg_quality: int = 92
    """1 to 95."""
    tangents: Literal["auto", "always", "never"] = "auto"
    """Whether tangents are written: by default where there is a normal map."""
    lods: tuple[int, ...] = ()
    """Further levels of detail as triangle counts, written beside the file as NAME_lod1, NAME_lod2 and so on."""
    lod_normals: bool = True
    """Bake the finest mesh's normals into a normal map for each level of detail."""
    quantize: bool = False
    """KHR_mesh_quantization: 16-bit positions, 8-bit normals and tangents, 16-bit UVs. Readers without it fail."""
    compression: Literal["none", "draco", "meshopt"] = "none"
    """KHR_draco_mesh_compression, by DracoPy, or EXT_meshopt_compression, by meshopt (`hir[compress]`). Readers without
    it fail."""
    environment: bool = True
    """Write the environment beside the file as NAME.hdr."""
    image_based_light: bool = False
    """EXT_lights_image_based: the environment inside the file too, prefiltered, for Babylon.js."""


@dataclass(frozen=True)
class UsdConfig:
    """Options of .usda and .usdc."""

    workflow: Literal["auto", "metallic", "specular"] = "auto"
    """Workflow of UsdPreviewSurface; auto: metallic, which every importer reads, unless specular says more."""
    budget: Literal["none", "quicklook", "web", "desktop"] = "none"
    """Bounds of a target: what has more triangles or larger textures is reduced, and the report says so."""
    max_texture_size: int = 4096
    """Larger textures are reduced to this many pixels a side."""
    meters_per_unit: float = 1.0
    """Written into the file; positions are not changed."""
    environment: bool = True
    """Write the environment as NAME.hdr and NAME_lit.usda, a layer that adds a dome light to the asset."""
    materialx: bool = False
    """Write NAME_openpbr.usda, a layer that adds the material as OpenPBR in MaterialX. Not in packages."""
    subsets: bool = True
    """Name the faces that some view saw, and the rest, as subsets `observed` and `unobserved`, where that is known."""


@dataclass(frozen=True)
class UsdzConfig(UsdConfig):
    """Options of .usdz, a package for AR Quick Look and everything else that reads USD."""

    workflow: Literal["auto", "metallic", "specular"] = "metallic"
    budget: Literal["none", "quicklook", "web", "desktop"] = "quicklook"
    max_texture_size: int = 2048
    subsets: bool = False


@dataclass(frozen=True)
class ObjConfig:
    """Options of .obj with .mtl."""

    max_texture_size: int = 4096
    """Larger textures are reduced to this many pixels a side."""


@dataclass(frozen=True)
class EnvironmentConfig:
    """Options of the environment as a lat-long image, .hdr or .exr."""

    height: int = 0
    """Rows of the image, which is twice as wide; 0 keeps the fitted resolution."""


@dataclass(frozen=True)
class CubeConfig:
    """Options of the environment as a prefiltered cubemap, .ktx or .dds."""

    size: int = 256
    """Pixels a side of its first level, a power of two; levels go down to 16, which stands for roughness 1."""


@dataclass(frozen=True)
class HarmonicsConfig:
    """Options of the environment as nine spherical harmonics; there are none."""
