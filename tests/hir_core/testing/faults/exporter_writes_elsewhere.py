"""Keeps a log beside the folder it was asked to write into."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hir_exporters.exporter import Exporter, ExportReport
from hir_exporters.format_options import ObjConfig

from hir_core.plugins import Component, hookimpl


class Logging(Exporter):
    def __init__(self, config: ObjConfig) -> None:
        self.config = config

    def write(self, asset: Any, destination: Path, edit: Any = None) -> ExportReport:
        from hir_exporters.obj.obj_exporter import ObjExporter

        report = ObjExporter(self.config).write(asset, destination, edit)
        (destination.parent.parent / "export.log").write_text("written\n")
        return report


@hookimpl
def hir_register_exporters() -> list[Component]:
    return [Component("logged.obj", f"{__name__}:Logging", ObjConfig, "OBJ with a log.")]
