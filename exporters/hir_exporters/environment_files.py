"""The environment as a file of its own: .hdr and .exr, lat-long, in world axes."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import Asset, validate_asset
from hir_exporters.configs import EnvironmentConfig
from hir_exporters.environment import world_radiance
from hir_exporters.exporter import Edit, Exporter, ExportReport
from hir_exporters.images import write_exr, write_hdr


@final
class HdrExporter(Exporter):
    """Radiance RGBE: 1/256 of a pixel's brightest channel is lost."""

    def __init__(self, config: EnvironmentConfig) -> None:
        self._config = config

    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        return _write(asset, destination, self._config, write_hdr)


@final
class ExrExporter(Exporter):
    """OpenEXR, float32: nothing is lost."""

    def __init__(self, config: EnvironmentConfig) -> None:
        self._config = config

    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        return _write(asset, destination, self._config, write_exr)


def _write(
    asset: Asset, destination: Path, config: EnvironmentConfig, writer: Callable[[Path, NDArray[np.float32]], None]
) -> ExportReport:
    start = time.perf_counter()
    validate_asset(asset)
    radiance, warnings = world_radiance(asset, config.height)
    writer(destination, radiance)
    return ExportReport((Path(destination),), warnings, seconds=time.perf_counter() - start)
