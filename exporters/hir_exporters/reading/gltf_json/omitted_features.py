"""What a glTF material has that an asset cannot represent. A value that changes nothing is not named."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import AssetMesh
from hir_exporters.mesh.open_surface import is_open
from hir_exporters.reading.gltf_geometry.gltf_decompression import DRACO, view_content
from hir_exporters.reading.gltf_json.gltf_surface import SPECULAR_GLOSSINESS, UNLIT, texture_references
from hir_exporters.reading.gltf_json.gltf_textures import GltfTextures, image_source
from hir_exporters.reading.gltf_json.stored_accessors import Json, buffers_of, sparse_values, stored_values
from hir_exporters.reading.gltf_json.used_material import placed_primitives
from hir_exporters.reading.texture_decoding import unit_values

_READ: Final = ("KHR_materials_specular", "KHR_materials_ior", SPECULAR_GLOSSINESS, UNLIT, "KHR_xmp_json_ld")
_OF_EMISSION: Final = "KHR_materials_emissive_strength"

_FACTORS: Final = {
    "KHR_materials_anisotropy": ("anisotropy", "anisotropyStrength"),
    "KHR_materials_clearcoat": ("clear coat", "clearcoatFactor"),
    "KHR_materials_diffuse_transmission": ("diffuse transmission", "diffuseTransmissionFactor"),
    "KHR_materials_dispersion": ("dispersion", "dispersion"),
    "KHR_materials_iridescence": ("iridescence", "iridescenceFactor"),
    "KHR_materials_sheen": ("sheen", "sheenColorFactor"),
    "KHR_materials_transmission": ("transmission", "transmissionFactor"),
    "KHR_materials_volume": ("volume", "thicknessFactor"),
}
"""Extension → its name in messages, and the factor that is 0 by default and without which it has no effect."""


def warn_of_omitted_features(material: Json, textures: GltfTextures, mesh: AssetMesh) -> None:
    """One warning that names each feature of the material and its mesh that changes the look and is not read."""
    found = [*_of_core(material, textures), *_of_extensions(material.get("extensions") or {})]
    found += _without_image(material, textures)
    if _has_vertex_colors(textures):
        found.append("vertex colours (COLOR_0)")
    if material.get("doubleSided") and is_open(mesh.positions, mesh.faces):
        found.append("the back of its open surface (doubleSided)")
    if textures.document.get("animations"):
        found.append("animations")
    if found:
        listed = " and ".join(filter(None, (", ".join(found[:-1]), found[-1])))
        warnings.warn(
            f"{textures.path} is read without {listed}, which cannot be represented; bake what should remain visible "
            "into the mesh or its base colour in the program that made it",
            stacklevel=2,
        )


def _has_vertex_colors(textures: GltfTextures) -> bool:
    """Whether a placed primitive has colours that are not white, by which glTF multiplies the base colour."""
    document = textures.document
    buffer = buffers_of(textures.path, document, textures.binary)
    return any(
        not _has_white_colors(document, primitive, buffer)
        for primitive in placed_primitives(document)
        if "COLOR_0" in primitive["attributes"]
    )


def _has_white_colors(document: Json, primitive: Json, buffer: Callable[[int], bytes]) -> bool:
    accessor = document["accessors"][primitive["attributes"]["COLOR_0"]]
    if accessor.get("sparse") is None:
        return _is_white(_vertex_colors(document, primitive, buffer))
    replaced, values = sparse_values(accessor, document, buffer)
    if not _is_white(values):
        return False
    if accessor.get("bufferView") is None:  # the others are 0
        return len(np.unique(replaced)) >= accessor["count"]
    stored = stored_values(document, {**accessor, "sparse": None}, buffer, decompress=True)
    return stored is not None and _is_white(np.delete(stored, replaced, axis=0))


def _vertex_colors(document: Json, primitive: Json, buffer: Callable[[int], bytes]) -> NDArray[Any] | None:
    """Colours (N, 3 or 4) as they are stored, or would be without compression; None where they are all 0."""
    compressed = (primitive.get("extensions") or {}).get(DRACO, {})
    identifier = compressed.get("attributes", {}).get("COLOR_0")
    if identifier is None:
        accessor = document["accessors"][primitive["attributes"]["COLOR_0"]]
        return stored_values(document, accessor, buffer, decompress=True)
    import DracoPy

    stream = view_content(document["bufferViews"][compressed["bufferView"]], buffer)
    attributes: Any = DracoPy.decode(stream).attributes
    return next((a["data"] for a in attributes if a["unique_id"] == identifier), None)


def _is_white(values: NDArray[Any] | None) -> bool:
    if values is None:
        return False
    white = 1.0 if values.dtype.kind == "f" else np.iinfo(values.dtype).max
    return bool((values[:, :3] >= white).all())


def _of_core(material: Json, textures: GltfTextures) -> Iterator[str]:
    if _is_translucent(material, textures):
        yield f"opacity (alphaMode {material['alphaMode']})"
    emission, glow = material.get("emissiveFactor") or (0, 0, 0), textures.pixels(material.get("emissiveTexture"))
    if any(emission) and (glow is None or glow[..., :3].any()):
        yield "emission"
    occlusion = material.get("occlusionTexture") or {}
    shadow = textures.pixels(occlusion or None)
    if shadow is not None and occlusion.get("strength", 1) != 0 and unit_values(shadow[..., 0]).min() < 1:
        yield "ambient occlusion"


def _is_translucent(material: Json, textures: GltfTextures) -> bool:
    mode = material.get("alphaMode", "OPAQUE")
    if mode == "OPAQUE":  # by which alpha is ignored
        return False
    core, old = material.get("pbrMetallicRoughness") or {}, (material.get("extensions") or {}).get(SPECULAR_GLOSSINESS)
    factor = core.get("baseColorFactor") if old is None else old.get("diffuseFactor")
    pixels = textures.pixels(core.get("baseColorTexture") if old is None else old.get("diffuseTexture"))
    alpha = 1.0 if factor is None else float(factor[3])
    if pixels is not None and pixels.shape[2] == 4:
        alpha *= float(unit_values(pixels[..., 3]).min())
    return alpha < (material.get("alphaCutoff", 0.5) if mode == "MASK" else 1)


def _of_extensions(extensions: Json) -> Iterator[str]:
    for name, value in extensions.items():
        if name in _FACTORS:
            words, factor = _FACTORS[name]
            if np.any(np.asarray(value.get(factor, 0), float) != 0):
                yield f"{words} ({name})"
        elif name == UNLIT:
            yield f"unlit shading ({name}; its colour is read as that of a rough dielectric)"
        elif name not in _READ and name != _OF_EMISSION:  # its strength is that of an emission, which is named
            yield str(name)[:80]


def _without_image(material: Json, textures: GltfTextures) -> Iterator[str]:
    references: list[Any] = [*texture_references(material)]
    for index in dict.fromkeys(reference["index"] for reference in references):
        texture = textures.document["textures"][index]
        if image_source(texture) is None:
            others = ", ".join(str(name)[:80] for name in texture.get("extensions") or {})
            yield f"texture {index} ({f'only {others} names its image' if others else 'it has no image'})"
