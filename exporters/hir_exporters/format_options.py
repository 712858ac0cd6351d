"""Options of each file format. The module imports nothing else, so that plugin descriptors can import it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class GltfConfig:
    """Options of .glb and .gltf."""

    profile: Literal["khr", "blender", "metalrough", "unity-legacy"] = "khr"
    """How the material is encoded: with the ratified extensions (khr), as Blender reads them, as core
    metallic-roughness, or as specular-glossiness for Unity's glTFast (unity-legacy)."""
    budget: Literal["none", "quicklook", "web", "desktop"] = "none"
    """Limits of a target: meshes and textures above them are reduced, and the report says so."""
    max_texture_size: int = 4096
    """Larger textures are reduced to this many pixels a side."""
    image_format: Literal["png", "jpeg", "ktx2"] = "png"
    """JPEG is smaller and loses detail; normal maps and alpha stay PNG. KTX2 is refused with an error that names a tool
    for it."""
    jpeg_quality: int = 92
    """1 to 95."""
    tangents: Literal["auto", "always", "never"] = "auto"
    """Whether tangents are written; auto: where there is a normal map."""
    lods: tuple[int, ...] = ()
    """Triangle counts of further levels of detail, written beside the file as NAME_lod1, NAME_lod2 and so on."""
    lod_normals: bool = True
    """Bake the normals of the full mesh into a normal map for each level of detail."""
    quantize: bool = False
    """KHR_mesh_quantization: 16-bit positions, 8-bit normals and tangents, 16-bit UVs. Readers without the extension
    cannot open the file."""
    compression: Literal["none", "draco", "meshopt"] = "none"
    """KHR_draco_mesh_compression (library DracoPy) or EXT_meshopt_compression (library meshopt), both in
    `hir[compress]`. Readers without the extension cannot open the file."""
    environment: bool = True
    """Write the environment beside the file as NAME.hdr."""
    image_based_light: bool = False
    """EXT_lights_image_based: also write the prefiltered environment into the file, for Babylon.js."""


@dataclass(frozen=True)
class UsdConfig:
    """Options of .usda and .usdc."""

    workflow: Literal["auto", "metallic", "specular"] = "auto"
    """Workflow of UsdPreviewSurface; auto: metallic, which every importer reads, unless specular is clearly closer."""
    budget: Literal["none", "quicklook", "web", "desktop"] = "none"
    """Limits of a target: meshes and textures above them are reduced, and the report says so."""
    max_texture_size: int = 4096
    """Larger textures are reduced to this many pixels a side."""
    meters_per_unit: float = 1.0
    """Metadata of the file; positions are not scaled."""
    environment: bool = True
    """Write the environment as NAME.hdr and NAME_lit.usda, a layer that adds a dome light to the asset."""
    materialx: bool = False
    """Write NAME_openpbr.usda, a layer that adds the material as OpenPBR in MaterialX. Not for .usdz."""
    subsets: bool = True
    """Write the face subsets `observed` and `unobserved`, where the asset says which texels a view observed."""


@dataclass(frozen=True)
class UsdzConfig(UsdConfig):
    """Options of .usdz, a package for AR Quick Look and other USD readers."""

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
    """Rows of the image, which is twice as wide; 0 keeps the asset's resolution."""


@dataclass(frozen=True)
class CubemapConfig:
    """Options of the environment as a prefiltered cubemap, .ktx."""

    size: int = 256
    """Side of the first level in pixels, a power of two; the last level, 16 pixels, is for roughness 1."""


@dataclass(frozen=True)
class HarmonicsConfig:
    """Options of the environment as nine spherical harmonics; there are none."""
