"""Writes centimetres where metres belong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from hir_exporters.exporter import Exporter, ExportReport
from hir_exporters.format_options import ObjConfig

from hir_core.plugins import Component, hookimpl


class Centimetres(Exporter):
    def __init__(self, config: ObjConfig) -> None:
        self.config = config

    def write(self, asset: Any, destination: Path, edit: Any = None) -> ExportReport:
        from hir_exporters.obj.obj_exporter import ObjExporter

        larger = replace(asset.mesh, positions=100 * asset.mesh.positions)
        return ObjExporter(self.config).write(replace(asset, mesh=larger), destination, edit)


@hookimpl
def hir_register_exporters() -> list[Component]:
    return [Component("cm.obj", f"{__name__}:Centimetres", ObjConfig, "OBJ in centimetres.")]
