"""Builds a typed glTF document (`pygltflib.GLTF2`) with its buffer and images from an asset."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hir_exporters.asset import Asset, AssetMaterial, AssetMesh
from hir_exporters.errors import ExportError
from hir_exporters.format_options import GltfConfig
from hir_exporters.gltf import image_based_light, ior, specular, specular_glossiness
from hir_exporters.gltf.binary import BinaryWriter
from hir_exporters.gltf.draco import add_draco_primitive
from hir_exporters.gltf.gltf_images import add_textures
from hir_exporters.gltf.mesh_primitives import add_primitive
from hir_exporters.gltf.quantization import add_quantized_primitive
from hir_exporters.light.environment_map import world_radiance
from hir_exporters.materials.material_conversion import to_gltf
from hir_exporters.materials.surfaces import MetallicSurface, SpecularSurface
from hir_exporters.materials.texture_packing import EncodedImage, PackedSurface, encode_images, pack_surface
from hir_exporters.mesh.tangents import with_tangents

if TYPE_CHECKING:
    from pygltflib import GLTF2, Material

GENERATOR = "hir_exporters"


@dataclass(frozen=True)
class GatheredAsset:
    """The parts of a glTF file: mesh, packed material with its images, light, and warnings of the conversion."""

    asset: Asset
    mesh: AssetMesh
    packed: PackedSurface
    specular_surface: SpecularSurface | None
    images: list[EncodedImage]
    light: tuple[list[EncodedImage], dict[str, object]] | None
    """Images of the prefiltered light and its JSON object, where the file includes it (`image_based_light`)."""
    warnings: tuple[str, ...]
    residuals: dict[str, float]


def gather_asset(asset: Asset, config: GltfConfig) -> GatheredAsset:
    """Converts the material, computes tangents where they are needed, and encodes the images."""
    needs_tangents = config.tangents == "always" or (config.tangents == "auto" and asset.material.normal is not None)
    with ThreadPoolExecutor(max_workers=1) as pool:
        mesh = pool.submit(with_tangents, asset.mesh) if needs_tangents else None
        converted, base, packed, images = _surface(asset.material, config)
    specular_surface = converted if isinstance(converted, SpecularSurface) else None
    return GatheredAsset(
        asset=asset,
        mesh=asset.mesh if mesh is None else mesh.result(),
        packed=packed,
        specular_surface=specular_surface,
        images=images,
        light=_light(asset, config),
        warnings=converted.warnings + _light_warning(asset, config),
        residuals={config.profile: converted.residual, "metalrough": base.residual}
        if specular_surface is not None
        else {config.profile: converted.residual},
    )


def _surface(
    material: AssetMaterial, config: GltfConfig
) -> tuple[MetallicSurface | SpecularSurface, MetallicSurface, PackedSurface, list[EncodedImage]]:
    """The material in the profile, its core metallic-roughness form, the latter packed, and all image files."""
    if config.image_format == "ktx2":
        raise ExportError(
            "image_format 'ktx2': no Python package encodes KTX2; export png, then convert the file with "
            "`gltf-transform uastc` or Khronos' toktx"
        )
    converted = to_gltf(material, config.profile)
    base = converted if isinstance(converted, MetallicSurface) else to_gltf(material, "metalrough")
    assert isinstance(base, MetallicSurface)
    packed = pack_surface(base, material.normal)
    pixels = {
        "base_color": packed.base_color_image,
        "occlusion_roughness_metallic": packed.orm_image,
        "normal": packed.normal_image,
        "specular": packed.specular_color_image
        if packed.specular_weight_image is None
        else packed.specular_weight_image,
    }
    named = [(name, image) for name, image in pixels.items() if image is not None]
    if isinstance(converted, SpecularSurface):
        named += specular_glossiness.specular_glossiness_images(converted).items()
    return converted, base, packed, encode_images(named, config.image_format, config.jpeg_quality)


def _light_warning(asset: Asset, config: GltfConfig) -> tuple[str, ...]:
    if not config.image_based_light or asset.environment is None:
        return ()
    peak = float(asset.environment.radiance.max())
    if peak <= image_based_light.MAX_RADIANCE:
        return ()
    return (f"the light inside the file is clipped from {peak:.0f} to 255, the limit of its images; the .hdr is not",)


def _light(asset: Asset, config: GltfConfig) -> tuple[list[EncodedImage], dict[str, object]] | None:
    if not config.image_based_light or asset.environment is None:
        return None
    return image_based_light.light_images(world_radiance(asset)[0])


def build_document(gathered: GatheredAsset, config: GltfConfig, files_prefix: str | None) -> tuple[GLTF2, BinaryWriter]:
    """The document and the writer of its buffer.

    Images go into the buffer, or are referenced as files whose names begin with `files_prefix`.
    """
    from pygltflib import GLTF2, Attributes, Mesh, Node, Scene
    from pygltflib import Asset as Header

    document = GLTF2(asset=Header(version="2.0", generator=GENERATOR))
    document.extensionsUsed, document.extensionsRequired = [], []
    if gathered.asset.provenance:
        document.asset.extras = {"hir": dict(gathered.asset.provenance)}
    writer = BinaryWriter(document, config.compression == "meshopt")
    node = Node(name=gathered.asset.name, mesh=0)
    if config.quantize and config.compression == "draco":
        raise ExportError("quantize and compression=draco both quantise the mesh; choose one of them")
    if config.compression == "draco":
        primitive = add_draco_primitive(document, gathered.mesh, writer, 0)
    elif config.quantize:
        primitive = add_quantized_primitive(document, gathered.mesh, writer, 0, node)
    else:
        primitive = add_primitive(gathered.mesh, writer, 0)
    if config.tangents == "never" or gathered.mesh.tangents is None:
        assert isinstance(primitive.attributes, Attributes)
        primitive.attributes.TANGENT = None
    uvs = gathered.mesh.uvs
    embedding = writer if files_prefix is None else None
    atlas = bool(uvs.min() >= 0 and uvs.max() <= 1)
    textures = add_textures(document, gathered.images, embedding, files_prefix or "", atlas)
    document.meshes.append(Mesh(name=gathered.asset.name, primitives=[primitive]))
    document.materials.append(_material(gathered, textures, document))
    document.nodes.append(node)
    document.scenes.append(Scene(nodes=[0]))
    document.scene = 0
    if gathered.light is not None:
        image_based_light.add_light(document, *gathered.light, embedding, files_prefix or "")
    writer.add_buffers()
    return document, writer


def _material(gathered: GatheredAsset, textures: dict[str, int], document: GLTF2) -> Material:
    from pygltflib import Material as GltfMaterial
    from pygltflib import NormalMaterialTexture, PbrMetallicRoughness, TextureInfo

    packed = gathered.packed
    core = PbrMetallicRoughness(
        baseColorFactor=[*packed.base_color, 1.0], metallicFactor=packed.metallic, roughnessFactor=packed.roughness
    )
    material = GltfMaterial(name=gathered.asset.name, pbrMetallicRoughness=core, alphaMode="OPAQUE", doubleSided=False)
    if "base_color" in textures:
        core.baseColorTexture = TextureInfo(index=textures["base_color"])
    if "occlusion_roughness_metallic" in textures:
        core.metallicRoughnessTexture = TextureInfo(index=textures["occlusion_roughness_metallic"])
    if "normal" in textures:
        material.normalTexture = NormalMaterialTexture(index=textures["normal"], scale=1.0)
    extensions: dict[str, Mapping[str, object] | None] = {}
    if gathered.specular_surface is not None:
        extensions[specular_glossiness.NAME] = specular_glossiness.specular_glossiness_extension(
            gathered.specular_surface, textures
        )
    else:
        extensions[specular.NAME] = specular.specular_extension(packed, textures)
        extensions[ior.NAME] = ior.ior_extension(packed.ior)
    material.extensions = {name: value for name, value in extensions.items() if value is not None}
    document.extensionsUsed += list(material.extensions)
    return material
