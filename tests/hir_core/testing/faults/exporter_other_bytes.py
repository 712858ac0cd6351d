"""Writes the time into the file."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from hir_exporters.exporter import Exporter, ExportReport
from hir_exporters.format_options import ObjConfig

from hir_core.plugins import Component, hookimpl


class Dated(Exporter):
    def __init__(self, config: ObjConfig) -> None:
        self.config = config

    def write(self, asset: Any, destination: Path, edit: Any = None) -> ExportReport:
        from hir_exporters.obj.obj_exporter import ObjExporter

        report = ObjExporter(self.config).write(asset, destination, edit)
        destination.write_text(f"# {int(time.time())}\n{destination.read_text()}")
        return report


@hookimpl
def hir_register_exporters() -> list[Component]:
    return [Component("dated.obj", f"{__name__}:Dated", ObjConfig, "OBJ with the time.")]
