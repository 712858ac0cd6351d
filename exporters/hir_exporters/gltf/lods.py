"""Levels of detail: fewer triangles with the same textures, and the fine mesh's normals in a normal map."""

from __future__ import annotations

from dataclasses import replace

from hir_exporters.asset import textures
from hir_exporters.format_options import GltfConfig
from hir_exporters.gltf.gltf_document import GatheredAsset
from hir_exporters.materials.texture_packing import encode_images
from hir_exporters.mesh.normal_baking import baked_normals
from hir_exporters.mesh.simplification import simplify
from hir_exporters.mesh.tangents import with_tangents
from hir_exporters.textures.texture_maps import normal_to_unorm8

DEFAULT_MAP_SIZE = 1024
"""Side of the normal map in pixels for assets without textures, if `max_texture_size` is not smaller."""


def level_of_detail(
    gathered: GatheredAsset, level: int, triangles: int, config: GltfConfig
) -> tuple[GatheredAsset, tuple[str, ...]]:
    """The gathered asset with about `triangles` triangles, and warnings."""
    coarse = simplify(replace(gathered.asset.mesh, tangents=None), triangles)
    warnings: tuple[str, ...] = ()
    if len(coarse.faces) > max(1.1 * triangles, triangles + 2):
        warnings += (f"level of detail {level} has {len(coarse.faces)} triangles: UV seams allow no fewer",)
    material = gathered.asset.material
    if not config.lod_normals:
        mesh = with_tangents(coarse) if gathered.mesh.tangents is not None else coarse
        return replace(gathered, mesh=mesh), warnings
    coarse = with_tangents(coarse)
    sizes = [max(value.shape[:2]) for _, value in textures(material)]
    size = max(sizes) if material.normal is None and sizes else DEFAULT_MAP_SIZE
    size = min(size if material.normal is None else max(material.normal.shape[:2]), config.max_texture_size)
    normal = baked_normals(gathered.asset.mesh, material.normal, coarse, size)
    if normal is None:
        warnings += (f"level of detail {level} keeps its own normals: its texture coordinates overlap or leave 0 to 1",)
        return replace(gathered, mesh=coarse), warnings
    codes = normal_to_unorm8(normal)
    others = [image for image in gathered.images if image.name != "normal.png"]
    images = others + encode_images([("normal", codes)])
    return replace(gathered, mesh=coarse, packed=replace(gathered.packed, normal_image=codes), images=images), warnings
