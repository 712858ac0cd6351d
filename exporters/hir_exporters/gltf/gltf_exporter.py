"""Exporters of .glb and .gltf."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, final
from urllib.parse import quote

from hir_exporters.asset import Asset, AssetEnvironment, validate_asset
from hir_exporters.budgets import BUDGETS, apply_budget, budget_images, fit_mesh
from hir_exporters.engines.engine_light_cache import cached_engine_light
from hir_exporters.exporter import Edit, Exporter, ExportReport, check_file_name, companion_file
from hir_exporters.files.atomic import write_bytes_atomic
from hir_exporters.format_options import GltfConfig
from hir_exporters.gltf.binary import glb_bytes
from hir_exporters.gltf.gltf_document import (
    RESIDUAL_SUFFIX,
    GatheredAsset,
    build_document,
    document_pixels,
    gather_asset,
    image_encoding,
)
from hir_exporters.gltf.lods import level_of_detail
from hir_exporters.light.environment_map import world_radiance
from hir_exporters.materials.texture_packing import limit_texture_sizes, texture_size_warnings
from hir_exporters.mesh.convex_decomposition import convex_hulls
from hir_exporters.textures.image_encoding import EncodedImage
from hir_exporters.textures.image_files import write_hdr
from hir_exporters.thumbnail.thumbnail import thumbnail_file, thumbnail_png

if TYPE_CHECKING:
    from pygltflib import GLTF2


@final
class GlbExporter(Exporter):
    """One binary file, with the environment beside it."""

    def __init__(self, config: GltfConfig) -> None:
        self._config = config

    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        return _write(asset, check_file_name(destination, ".glb"), self._config, edit, embed=True)


@final
class GltfExporter(Exporter):
    """A JSON file, with a .bin, image files and the environment beside it."""

    def __init__(self, config: GltfConfig) -> None:
        self._config = config

    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        return _write(asset, check_file_name(destination, ".gltf"), self._config, edit, embed=False)


def _write(asset: Asset, destination: Path, config: GltfConfig, edit: Edit | None, embed: bool) -> ExportReport:
    start, whole = time.perf_counter(), asset
    validate_asset(asset)
    encoding = image_encoding(config)
    light = None
    if config.profile == "engine" and asset.environment is not None:
        light = cached_engine_light(asset, config.lights)
    asset, warnings = apply_budget(asset, config.budget)
    warnings += texture_size_warnings(asset.material, config.max_texture_size)
    asset = replace(asset, material=limit_texture_sizes(asset.material, config.max_texture_size))
    if light is not None and asset.environment is not None:
        asset = replace(asset, environment=AssetEnvironment(light.split.residual, lamp=asset.environment.lamp))
        warnings += (light.sentence(), *light.warnings)
    gathered = gather_asset(asset, config, light)
    if BUDGETS[config.budget].bytes is not None:
        smaller, mesh_warnings = fit_mesh(asset, config.budget, _bytes_without_images([gathered], config))
        if mesh_warnings:
            asset, warnings = smaller, warnings + mesh_warnings
            gathered = gather_asset(asset, config, light)
    warnings += gathered.warnings
    if config.collision != "none":
        gathered = replace(gathered, collision=convex_hulls(asset.mesh, config.collision_hulls))
    levels, finer, finest = [gathered], asset, replace(asset, mesh=gathered.mesh)
    for level, triangles in enumerate(config.lods, start=1):
        finer, lod_warnings = level_of_detail(finest, finer, level, triangles, config)
        warnings += lod_warnings
        levels.append(gather_asset(finer, config, light))
    paths = [destination.with_name(f"{destination.stem}_lod{k}{destination.suffix}") for k in range(1, len(levels))]
    files: list[Path] = []
    documents = [levels] if config.lod_layout == "msft_lod" else [[level] for level in levels]
    for document_levels, path in zip(documents, [destination, *paths], strict=False):
        overhead = 0 if config.budget == "none" else _bytes_without_images(document_levels, config)
        images, image_warnings = budget_images(document_pixels(document_levels), config.budget, overhead, encoding)
        warnings += image_warnings if path == destination else ()
        files += _write_document(document_levels, images, path, config, edit, embed)
    if config.environment and asset.environment is not None:
        radiance, light_warnings = world_radiance(asset)
        residual = companion_file(destination, RESIDUAL_SUFFIX)
        files.append(destination.with_suffix(".hdr") if light is None else residual)
        write_hdr(files[-1], radiance)
        warnings += light_warnings
    if config.thumbnail:
        files.append(thumbnail_file(destination))
        write_bytes_atomic(files[-1], thumbnail_png(whole))
    return ExportReport(tuple(files), warnings, gathered.residuals, time.perf_counter() - start)


_SLACK_BYTES: Final = 2048
"""For the padding and the longer numbers of a document with its images."""


def _bytes_without_images(levels: Sequence[GatheredAsset], config: GltfConfig) -> int:
    empty = {key: EncodedImage(f"{key}.png", b"", "image/png") for key in document_pixels(levels)}
    document, writer = build_document(levels, empty, config, None)
    return len(glb_bytes(json_bytes(document), writer.data())) + _SLACK_BYTES


def _write_document(
    levels: Sequence[GatheredAsset],
    images: Mapping[str, EncodedImage],
    destination: Path,
    config: GltfConfig,
    edit: Edit | None,
    embed: bool,
) -> list[Path]:
    prefix = None if embed else companion_file(destination, "").name
    document, writer = build_document(levels, images, config, prefix)
    if not embed:
        document.buffers[0].uri = quote(f"{destination.stem}.bin")
    if edit is not None:
        edit(document, levels[0].asset)

    files = [destination]
    if embed:
        write_bytes_atomic(destination, glb_bytes(json_bytes(document), writer.data()))
    else:
        # The file that references the others is written last, when all of them exist.
        fallbacks = [image.fallback for image in images.values() if image.fallback is not None]
        light = levels[0].light[0] if levels[0].light else []
        for image in [*images.values(), *fallbacks, *light]:
            files.append(companion_file(destination, image.name))
            write_bytes_atomic(files[-1], image.data)
        files.append(destination.with_suffix(".bin"))
        write_bytes_atomic(destination.with_suffix(".bin"), writer.data())
        write_bytes_atomic(destination, json_bytes(document, indent=2))
    return files


def json_bytes(document: GLTF2, indent: int | None = None) -> bytes:
    """The document's JSON in UTF-8. Raises `ValueError` for NaN and infinite values."""
    content = json.loads(document.gltf_to_json())
    separators = (",", ":") if indent is None else (",", ": ")
    return json.dumps(content, ensure_ascii=False, allow_nan=False, indent=indent, separators=separators).encode(
        "utf-8"
    )
