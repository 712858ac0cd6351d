"""Builds a typed glTF document (`pygltflib.GLTF2`) with its buffer and images from an asset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from hir_exporters.asset import Asset, AssetMaterial, AssetMesh
from hir_exporters.asset_lamp import described_provenance
from hir_exporters.engines.engine_light import EngineLight
from hir_exporters.errors import ExportError
from hir_exporters.format_options import GltfConfig
from hir_exporters.gltf import image_based_light
from hir_exporters.gltf.binary import BinaryWriter
from hir_exporters.gltf.collision_nodes import add_collision_nodes
from hir_exporters.gltf.draco import add_draco_primitive
from hir_exporters.gltf.extensions import ior, msft_lod, punctual_lights, specular, specular_glossiness, xmp
from hir_exporters.gltf.gltf_images import add_textures
from hir_exporters.gltf.mesh_primitives import add_primitive
from hir_exporters.gltf.quantization import add_quantized_primitive
from hir_exporters.light.environment_map import world_radiance
from hir_exporters.materials.material_conversion import to_gltf
from hir_exporters.materials.surfaces import MetallicSurface, SpecularSurface
from hir_exporters.materials.texture_packing import PackedSurface, is_flat, pack_surface
from hir_exporters.mesh.convex_decomposition import ConvexHull
from hir_exporters.mesh.tangents import with_tangents
from hir_exporters.textures.image_encoding import FALLBACK_SIZE, EncodedImage, Image8, ImageEncoding, reduced
from hir_exporters.textures.ktx2 import require_encoder

if TYPE_CHECKING:
    from pygltflib import GLTF2, Material

GENERATOR = "hir_exporters"

RESIDUAL_SUFFIX: Final = "residual.hdr"
"""End of the name of the residual environment beside a file of profile engine."""

METALLIC_TEXTURES: Final = ("base_color", "occlusion_roughness_metallic")
"""What a reader of KHR_materials_pbrSpecularGlossiness does not use."""


@dataclass(frozen=True)
class GatheredAsset:
    """The parts of a glTF file: mesh, packed material with its images' pixels, light, warnings of the conversion."""

    asset: Asset
    mesh: AssetMesh
    packed: PackedSurface
    specular_surface: SpecularSurface | None
    pixels: dict[str, Image8]
    """Images by the name of their texture."""
    light: tuple[list[EncodedImage], dict[str, object]] | None
    """Images of the prefiltered light and its JSON object, where the file includes it (`image_based_light`)."""
    engine_light: EngineLight | None
    """The lights of profile engine, where the asset has an environment."""
    warnings: tuple[str, ...]
    residuals: dict[str, float]
    collision: tuple[ConvexHull, ...] = ()
    """Collision shapes, where the file has them."""


def gather_asset(asset: Asset, config: GltfConfig, engine_light: EngineLight | None = None) -> GatheredAsset:
    """Converts the material and computes tangents where they are needed.

    With `engine_light` the asset's environment is its residual.
    """
    if asset.material.normal is not None and is_flat(asset.material.normal):
        asset = replace(asset, material=replace(asset.material, normal=None))
    needs_tangents = config.tangents == "always" or (config.tangents == "auto" and asset.material.normal is not None)
    with ThreadPoolExecutor(max_workers=1) as pool:
        mesh = pool.submit(with_tangents, asset.mesh) if needs_tangents else None
        converted, base, packed, pixels = _surface(asset.material, config)
    specular_surface = converted if isinstance(converted, SpecularSurface) else None
    return GatheredAsset(
        asset=asset,
        mesh=asset.mesh if mesh is None else mesh.result(),
        packed=packed,
        specular_surface=specular_surface,
        pixels=pixels,
        light=_light(asset, config),
        engine_light=engine_light,
        warnings=converted.warnings + _light_warning(asset, config),
        residuals={config.profile: converted.residual, "metalrough": base.residual}
        if specular_surface is not None
        else {config.profile: converted.residual},
    )


def _surface(
    material: AssetMaterial, config: GltfConfig
) -> tuple[MetallicSurface | SpecularSurface, MetallicSurface, PackedSurface, dict[str, Image8]]:
    """The material in the profile, its core metallic-roughness form, the latter packed, and all images."""
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
    named = {name: image for name, image in pixels.items() if image is not None}
    if isinstance(converted, SpecularSurface):
        # for readers without the extension: two whole sets of textures would double the file
        small = {name: reduced(named[name], FALLBACK_SIZE) for name in METALLIC_TEXTURES if name in named}
        named |= small | specular_glossiness.specular_glossiness_images(converted)
    return converted, base, packed, named


def image_encoding(config: GltfConfig) -> ImageEncoding:
    """How the images of a file are encoded where no budget asks for less.

    Raises `ExportError` where an encoder is missing.
    """
    if config.image_format == "ktx2":
        require_encoder()
    return ImageEncoding(config.image_format, config.jpeg_quality)


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


def build_document(
    levels: Sequence[GatheredAsset],
    images: Mapping[str, EncodedImage],
    config: GltfConfig,
    files_prefix: str | None,
) -> tuple[GLTF2, BinaryWriter]:
    """The document and the writer of its buffer.

    `levels` are the asset and its levels of detail in the same file, if any; `images` those of all levels, by the keys
    of `level_images`. Images go into the buffer, or are referenced as files whose names begin with `files_prefix`.
    """
    from pygltflib import GLTF2, Scene
    from pygltflib import Asset as Header

    finest = levels[0]
    document = GLTF2(asset=Header(version="2.0", generator=GENERATOR))
    document.extensionsUsed, document.extensionsRequired = [], []
    if provenance := described_provenance(finest.asset.provenance, finest.asset.lamp):
        document.asset.extras = {"hir": provenance}
    writer = BinaryWriter(document, config.compression == "meshopt")
    embedding = writer if files_prefix is None else None
    for level, gathered in enumerate(levels):
        _add_level(document, writer, level, gathered, config)
    atlas = all(bool(g.mesh.uvs.min() >= 0 and g.mesh.uvs.max() <= 1) for g in levels)
    textures = add_textures(document, images, embedding, files_prefix or "", atlas)
    for level, gathered in enumerate(levels):
        own = {name: textures[key] for name, key in level_images(levels, level).items()}
        document.materials.append(_material(gathered, own, document, _level_name(finest.asset.name, level)))
    if len(levels) > 1:
        msft_lod.add_levels(document, [len(g.mesh.faces) for g in levels])
    document.scenes.append(Scene(nodes=[0]))
    document.scene = 0
    if config.xmp:
        xmp.add_provenance(document, finest.asset, finest.residuals[config.profile])
    if config.collision != "none":
        add_collision_nodes(document, finest.collision, config.collision, finest.asset.name, writer)
    if config.profile == "engine":
        _add_engine_profile(document, finest, config)
    if finest.light is not None:
        image_based_light.add_light(document, *finest.light, embedding, files_prefix or "")
    writer.add_buffers()
    for names in (document.extensionsUsed, document.extensionsRequired):
        names[:] = dict.fromkeys(names)  # each level adds those that it uses
    return document, writer


def _add_engine_profile(document: GLTF2, gathered: GatheredAsset, config: GltfConfig) -> None:
    """Adds the lights, and extras of the scene that say how the file differs from the asset."""
    done: dict[str, object] = {
        "profile": "engine",
        "base_color": "changed where metalness is above 0, for engines that add multiple scattering",
    }
    if gathered.engine_light is not None:
        punctual_lights.add_lights(document, gathered.engine_light.split, config.light_type, gathered.asset.mesh)
        done["light"] = gathered.engine_light.document(RESIDUAL_SUFFIX)
    document.scenes[0].extras = {"hir": done}


def level_images(levels: Sequence[GatheredAsset], level: int) -> dict[str, str]:
    """For each texture of a level the key of its image: the finest level's where both have the same pixels."""
    finest = levels[0].pixels
    return {
        name: name if level == 0 or np.array_equal(pixels, finest.get(name, ())) else _level_name(name, level)
        for name, pixels in levels[level].pixels.items()
    }


def document_pixels(levels: Sequence[GatheredAsset]) -> dict[str, Image8]:
    """The images of all levels by the keys of `level_images`."""
    return {
        key: gathered.pixels[name]
        for level, gathered in enumerate(levels)
        for name, key in level_images(levels, level).items()
    }


def _level_name(name: str, level: int) -> str:
    return f"{name}_lod{level}" if level else name


def _add_level(document: GLTF2, writer: BinaryWriter, level: int, gathered: GatheredAsset, config: GltfConfig) -> None:
    """Adds the mesh and the node of a level; its material has the same index."""
    from pygltflib import Attributes, Mesh, Node

    name = _level_name(gathered.asset.name, level)
    node = Node(name=name, mesh=level)
    if config.quantize and config.compression == "draco":
        raise ExportError("quantize and compression=draco both quantise the mesh; choose one of them")
    if config.compression == "draco":
        primitive = add_draco_primitive(document, gathered.mesh, writer, level)
    elif config.quantize:
        primitive = add_quantized_primitive(document, gathered.mesh, writer, level, node)
    else:
        primitive = add_primitive(gathered.mesh, writer, level)
    if config.tangents == "never" or gathered.mesh.tangents is None:
        assert isinstance(primitive.attributes, Attributes)
        primitive.attributes.TANGENT = None
    document.meshes.append(Mesh(name=name, primitives=[primitive]))
    document.nodes.append(node)


def _material(gathered: GatheredAsset, textures: Mapping[str, int], document: GLTF2, name: str) -> Material:
    from pygltflib import Material as GltfMaterial
    from pygltflib import NormalMaterialTexture, PbrMetallicRoughness, TextureInfo

    packed = gathered.packed
    core = PbrMetallicRoughness(
        baseColorFactor=[*packed.base_color, 1.0], metallicFactor=packed.metallic, roughnessFactor=packed.roughness
    )
    material = GltfMaterial(name=name, pbrMetallicRoughness=core, alphaMode="OPAQUE", doubleSided=False)
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
