"""KHR_materials_specular: weight and colour of the reflectance at normal incidence."""

from __future__ import annotations

from collections.abc import Mapping

from hir_exporters.materials.texture_packing import PackedSurface

NAME = "KHR_materials_specular"


def specular_extension(packed: PackedSurface, textures: Mapping[str, int]) -> dict[str, object] | None:
    """The extension's JSON object, or None for weight 1 and colour 1, the values of core glTF."""
    value: dict[str, object] = {}
    if packed.specular_weight != 1:
        value["specularFactor"] = packed.specular_weight
    if packed.specular_color != (1, 1, 1):
        value["specularColorFactor"] = list(packed.specular_color)
    if packed.specular_weight_image is not None:
        value["specularTexture"] = {"index": textures["specular"]}
    if packed.specular_color_image is not None:
        value["specularColorTexture"] = {"index": textures["specular"]}
    return value or None
