"""Exporters of the environment alone, in world axes: lat-long .hdr and .exr, prefiltered cubemap, harmonics."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import Asset, validate_asset
from hir_exporters.engines.engine_light_cache import cached_engine_light
from hir_exporters.environment_files.ktx1_container import ktx1_bytes
from hir_exporters.exporter import Edit, Exporter, ExportReport, check_file_name
from hir_exporters.files.atomic import write_bytes_atomic, write_text_atomic
from hir_exporters.format_options import CubemapConfig, EnvironmentConfig, HarmonicsConfig
from hir_exporters.light.environment_map import (
    irradiance_harmonics,
    resample_latlong,
    spherical_harmonics,
    world_radiance,
)
from hir_exporters.light.prefilter import filament_roughness, level_sizes, prefiltered_cubemap
from hir_exporters.textures.image_files import write_exr, write_hdr

Array = NDArray[np.float64]


@final
class HdrExporter(Exporter):
    """Radiance RGBE: the error is at most 1/256 of a pixel's brightest channel."""

    def __init__(self, config: EnvironmentConfig) -> None:
        self._config = config

    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        return _write(asset, check_file_name(destination, ".hdr"), self._config, write_hdr)


@final
class ExrExporter(Exporter):
    """OpenEXR in float32, without loss."""

    def __init__(self, config: EnvironmentConfig) -> None:
        self._config = config

    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        return _write(asset, check_file_name(destination, ".exr"), self._config, write_exr)


@final
class KtxExporter(Exporter):
    """Prefiltered cubemap in KTX 1 with irradiance harmonics in its metadata `sh`: Filament's indirect light."""

    def __init__(self, config: CubemapConfig) -> None:
        self._config = config

    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        start, size, destination = time.perf_counter(), self._config.size, check_file_name(destination, ".ktx")
        validate_asset(asset)
        radiance, warnings = _radiance(asset, self._config)
        levels = len(level_sizes(size))
        cubemap = prefiltered_cubemap(radiance, [filament_roughness(k, levels) for k in range(levels)], size)
        write_bytes_atomic(destination, ktx1_bytes(cubemap, {"sh": filament_harmonics(radiance)}))
        return ExportReport((Path(destination),), warnings, seconds=time.perf_counter() - start)


@final
class HarmonicsExporter(Exporter):
    """Nine coefficients of radiance and of irradiance for each channel, as JSON that names its basis."""

    def __init__(self, config: HarmonicsConfig) -> None:
        self._config = config

    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        start, destination = time.perf_counter(), check_file_name(destination, ".sh.json")
        validate_asset(asset)
        radiance, warnings = _radiance(asset, self._config)
        document = {
            "basis": "real spherical harmonics, bands 0 to 2, m = -l..l, world axes (x, y, z), +Y up",
            "order": ["1", "y", "z", "x", "xy", "yz", "3zz-1", "xz", "xx-yy"],
            "radiance": spherical_harmonics(radiance).tolist(),
            "irradiance": irradiance_harmonics(radiance).tolist(),
        }
        write_text_atomic(destination, json.dumps(document, indent=1, allow_nan=False) + "\n")
        return ExportReport((Path(destination),), warnings, seconds=time.perf_counter() - start)


def filament_harmonics(radiance: NDArray[np.floating]) -> str:
    """Irradiance / pi times the constants of the basis functions: the format of Filament's cmgen and of its shaders."""
    y00, y1, y2, y20, y22 = 0.282095, 0.488603, 1.092548, 0.315392, 0.546274
    constants = np.array([y00, y1, y1, y1, y2, y2, y20, y2, y22])
    rows = irradiance_harmonics(radiance) / np.pi * constants[:, None]
    return "\n".join(" ".join(f"{x:.9g}" for x in row) for row in rows) + "\n"


def _radiance(asset: Asset, config: HarmonicsConfig, height: int = 0) -> tuple[NDArray[np.float32], tuple[str, ...]]:
    """The light in world axes, or what remains of it beside the lights of profile engine."""
    if config.profile == "unaltered":
        return world_radiance(asset, height)
    light = cached_engine_light(asset, config.lights)
    residual = light.split.residual
    if height:
        residual = resample_latlong(residual, height, 2 * height).astype(np.float32)
    return residual, light.warnings


def _write(
    asset: Asset, destination: Path, config: EnvironmentConfig, writer: Callable[[Path, NDArray[np.float32]], None]
) -> ExportReport:
    start = time.perf_counter()
    validate_asset(asset)
    radiance, warnings = _radiance(asset, config, config.height)
    writer(destination, radiance)
    return ExportReport((Path(destination),), warnings, seconds=time.perf_counter() - start)
