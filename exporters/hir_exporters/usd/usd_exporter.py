"""Exporters of .usda, .usdc and .usdz."""

from __future__ import annotations

import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, final

from hir_exporters.asset import Asset, validate_asset
from hir_exporters.budgets import BUDGETS, apply_budget, budget_images, fit_mesh
from hir_exporters.engines.engine_light_cache import cached_engine_light
from hir_exporters.errors import ExportError
from hir_exporters.exporter import Edit, Exporter, ExportReport, companion_file
from hir_exporters.files.atomic import write_bytes_atomic, write_text_atomic
from hir_exporters.format_options import UsdConfig
from hir_exporters.light.environment_map import world_radiance
from hir_exporters.materials.texture_packing import limit_texture_sizes, texture_size_warnings
from hir_exporters.mesh.convex_decomposition import convex_hulls
from hir_exporters.textures.image_encoding import EncodedImage, ImageEncoding
from hir_exporters.textures.image_files import write_hdr
from hir_exporters.thumbnail.thumbnail import thumbnail_file, thumbnail_png
from hir_exporters.usd.collision_prims import add_collision_prims
from hir_exporters.usd.dome_light import distant_lights, light_layer
from hir_exporters.usd.openpbr import openpbr_layer
from hir_exporters.usd.preview_surface import UsdSurface, usd_surface
from hir_exporters.usd.thumbnail_info import PACKAGED_THUMBNAIL, add_thumbnail_info
from hir_exporters.usd.usd_stage import build_stage, prim_name
from hir_exporters.usd.usdz_package import PackageSizeError, usdz_bytes
from hir_exporters.usd_library import require_usd

if TYPE_CHECKING:
    from pxr import Sdf, Usd

QUICK_LOOK_BYTES = 25 << 20
"""Larger packages load slowly on phones; the report warns."""


@final
class UsdExporter(Exporter):
    """A text (.usda) or binary (.usdc) layer, with textures and a layer with the light beside it."""

    def __init__(self, config: UsdConfig) -> None:
        self._config = config

    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        start, destination = time.perf_counter(), Path(destination)
        if destination.suffix not in (".usda", ".usdc", ".usd"):
            raise ExportError(f"{destination} is not a file name of a USD layer; it must end with .usda or .usdc")
        _check_name(destination)
        require_usd(destination, ExportError)
        config = self._config
        if config.materialx and config.workflow == "specular":
            raise ExportError("materialx: OpenPBR is written from the metallic workflow; set workflow=metallic or auto")
        validate_asset(asset)
        whole = asset
        asset, surface, images, warnings = _gather(asset, config)
        paths = {name: f"./{companion_file(destination, image.name).name}" for name, image in images.items()}
        picture = thumbnail_file(destination)
        stage = _stage(asset, surface, paths, config, f"./{picture.name}", edit)
        layer = layer_bytes(stage.GetRootLayer(), destination.suffix)
        files = [destination]
        for image in images.values():
            files.append(companion_file(destination, image.name))
            write_bytes_atomic(files[-1], image.data)
        write_bytes_atomic(destination, layer)
        if config.materialx:
            files.append(companion_file(destination, "openpbr.usda"))
            over = openpbr_layer(surface, prim_name(asset.name), destination.name, paths, config.meters_per_unit)
            write_bytes_atomic(files[-1], layer_bytes(over, ".usda"))
        if config.thumbnail:
            files.append(picture)
            write_bytes_atomic(picture, thumbnail_png(whole))
        light_files, light_warnings = _write_light(whole, destination, config)
        return _report(files + light_files, warnings + light_warnings, surface, start)


@final
class UsdzExporter(Exporter):
    """One package without lights, as AR Quick Look demands, and a layer beside it that adds the light."""

    def __init__(self, config: UsdConfig) -> None:
        self._config = config

    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        start, destination = time.perf_counter(), Path(destination)
        if destination.suffix != ".usdz":
            raise ExportError(f"{destination} is not a file name of a USD package; it must end with .usdz")
        _check_name(destination)
        require_usd(destination, ExportError)
        if self._config.materialx:
            raise ExportError("materialx: AR Quick Look does not read MaterialX; export usda or usdc instead")
        validate_asset(asset)
        whole = asset
        pictures = [(PACKAGED_THUMBNAIL, thumbnail_png(whole))] if self._config.thumbnail else []
        asset, surface, images, warnings = _gather(asset, self._config, sum(len(data) for _, data in pictures))
        names = {name: image.name for name, image in images.items()}
        stage = _stage(asset, surface, names, self._config, PACKAGED_THUMBNAIL, edit)
        root = f"{prim_name(asset.name)}.usdc", layer_bytes(stage.GetRootLayer(), ".usdc")
        try:
            package = usdz_bytes([root, *((image.name, image.data) for image in images.values()), *pictures])
        except PackageSizeError as error:
            raise ExportError(f"{destination} would be larger than 4 GiB; reduce max_texture_size") from error
        if len(package) > QUICK_LOOK_BYTES:
            warnings += (
                f"{destination.name} has {len(package) >> 20} MiB; more than {QUICK_LOOK_BYTES >> 20} MiB load slowly "
                "on phones",
            )
        write_bytes_atomic(destination, package)
        light_files, light_warnings = _write_light(whole, destination, self._config)
        return _report([destination, *light_files], warnings + light_warnings, surface, start)


def layer_bytes(layer: Sdf.Layer, suffix: str) -> bytes:
    """The content of the layer's file in the format of that suffix."""
    from pxr import Tf

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"layer{suffix}"
        try:
            succeeded = layer.Export(str(path))
        except Tf.ErrorException:  # its message is several lines about USD's source code
            succeeded = False
        if not succeeded:
            raise ExportError(
                f"USD could not write layer{suffix} into the temporary folder {folder}; check its permissions and free "
                "space, or set TMPDIR to another folder"
            )
        return path.read_bytes()


def _stage(
    asset: Asset,
    surface: UsdSurface,
    textures: dict[str, str],
    config: UsdConfig,
    thumbnail: str,
    edit: Edit | None,
) -> Usd.Stage:
    """The finished stage; `textures` and `thumbnail` are paths relative to its layer."""
    stage = build_stage(asset, surface, textures, config.meters_per_unit, config.subsets)
    if config.collision:
        add_collision_prims(stage, convex_hulls(asset.mesh, config.collision_hulls))
    if config.thumbnail:
        add_thumbnail_info(stage, thumbnail)
    if edit is not None:
        edit(stage, asset)
    return stage


def _gather(
    asset: Asset, config: UsdConfig, other_bytes: int = 0
) -> tuple[Asset, UsdSurface, dict[str, EncodedImage], tuple[str, ...]]:
    """The asset within the budget, its material and its images. `other_bytes` of the budget are used otherwise."""
    asset, warnings = apply_budget(asset, config.budget)
    warnings += texture_size_warnings(asset.material, config.max_texture_size)
    asset = replace(asset, material=limit_texture_sizes(asset.material, config.max_texture_size))
    surface = usd_surface(asset.material, "metallic" if config.materialx else config.workflow)
    size = 0
    if BUDGETS[config.budget].bytes is not None:
        size = other_bytes + _bytes_without_images(asset, surface, config)
        asset, mesh_warnings = fit_mesh(asset, config.budget, size)
        warnings += mesh_warnings
        size = other_bytes + _bytes_without_images(asset, surface, config)
    encoding = ImageEncoding(config.image_format, config.jpeg_quality)
    images, image_warnings = budget_images(surface.images, config.budget, size, encoding)
    return asset, surface, images, warnings + surface.warnings + image_warnings


_SLACK_BYTES: Final = 4096
"""For the directory of a package and the alignment of its files."""


def _bytes_without_images(asset: Asset, surface: UsdSurface, config: UsdConfig) -> int:
    stage = build_stage(
        asset, surface, {name: f"{name}.png" for name in surface.images}, config.meters_per_unit, config.subsets
    )
    return len(layer_bytes(stage.GetRootLayer(), ".usdc")) + _SLACK_BYTES


def _write_light(asset: Asset, destination: Path, config: UsdConfig) -> tuple[list[Path], tuple[str, ...]]:
    if not config.environment or asset.environment is None:
        return [], ()
    layer = companion_file(destination, "lit.usda")
    if config.profile == "engine":
        light = cached_engine_light(asset, config.lights)
        image, radiance, warnings = companion_file(destination, "residual.hdr"), light.split.residual, light.warnings
        warnings += (light.sentence(),)
    else:
        light, image = None, destination.with_suffix(".hdr")
        radiance, warnings = world_radiance(asset)
    write_hdr(image, radiance)
    lights = "" if light is None else distant_lights(light.split)
    text = light_layer(prim_name(asset.name), destination.name, image.name, config.meters_per_unit, lights)
    write_text_atomic(layer, text)
    return [image, layer], warnings


def _check_name(destination: Path) -> None:
    if "@" in destination.name:
        raise ExportError(f"{destination.name} contains '@', which USD uses to quote file names; choose another name")


def _report(files: list[Path], warnings: tuple[str, ...], surface: UsdSurface, start: float) -> ExportReport:
    residuals = {f"usd-{surface.workflow}": surface.residual}
    return ExportReport(tuple(files), warnings, residuals, time.perf_counter() - start)
