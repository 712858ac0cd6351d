"""Levels of detail: fewer triangles, and the fine mesh's normals in a normal map."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from hir_exporters.asset import Asset, AssetMaterial, textures
from hir_exporters.format_options import GltfConfig
from hir_exporters.materials.texture_packing import limit_texture_sizes
from hir_exporters.mesh.normal_baking import baked_normals
from hir_exporters.mesh.simplification import simplify
from hir_exporters.mesh.tangents import with_tangents

DEFAULT_MAP_SIZE: Final = 1024
"""Side of the normal map in pixels for assets without textures, if `max_texture_size` is not smaller."""

SMALLEST_MAP_SIZE: Final = 256
"""Textures of coarser levels are not reduced below this many pixels a side."""


def level_of_detail(
    asset: Asset, finer: Asset, level: int, triangles: int, config: GltfConfig
) -> tuple[Asset, tuple[str, ...]]:
    """The asset with about `triangles` triangles, and warnings. `finer` is the level before, which is simplified.

    In files of their own, levels have textures of half the size of the level before. In one file they share the asset's
    textures, all but the normal map.
    """
    coarse = simplify(replace(finer.mesh, tangents=None), triangles)
    warnings: tuple[str, ...] = ()
    if triangles >= len(finer.mesh.faces):
        warnings += (
            f"level of detail {level} is as fine as the one before, which has {len(finer.mesh.faces)} triangles; ask "
            "for fewer",
        )
    if len(coarse.faces) > max(1.1 * triangles, triangles + 2):
        warnings += (f"level of detail {level} has {len(coarse.faces)} triangles: UV seams allow no fewer",)
    shared, material = config.lod_layout == "msft_lod", asset.material
    full = _normal_map_size(material, config)
    size = max(full >> level, min(full, SMALLEST_MAP_SIZE))
    reduced = material if shared else limit_texture_sizes(material, _limit(material, level))
    if not config.lod_normals:
        return replace(asset, mesh=coarse, material=reduced), warnings
    coarse = with_tangents(coarse)
    normal = baked_normals(asset.mesh, material.normal, coarse, size)
    if normal is None:
        warnings += (f"level of detail {level} keeps its own normals: its texture coordinates overlap or leave 0 to 1",)
    return replace(asset, mesh=coarse, material=replace(reduced, normal=normal)), warnings


def _normal_map_size(material: AssetMaterial, config: GltfConfig) -> int:
    """Side of the finest level's normal map, or of the one that it would have."""
    sizes = [max(value.shape[:2]) for _, value in textures(material)]
    size = max(sizes) if material.normal is None and sizes else DEFAULT_MAP_SIZE
    return min(size if material.normal is None else max(material.normal.shape[:2]), config.max_texture_size)


def _limit(material: AssetMaterial, level: int) -> int:
    """Largest side of a level's textures."""
    largest = max((max(value.shape[:2]) for _, value in textures(material)), default=1)
    return max(largest >> level, min(largest, SMALLEST_MAP_SIZE))
