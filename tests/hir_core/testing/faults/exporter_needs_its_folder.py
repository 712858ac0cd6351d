"""Expects that the folder of its destination exists."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hir_exporters.exporter import Exporter, ExportReport
from hir_exporters.format_options import ObjConfig

from hir_core.plugins import Component, hookimpl


class Expecting(Exporter):
    def __init__(self, config: ObjConfig) -> None:
        self.config = config

    def write(self, asset: Any, destination: Path, edit: Any = None) -> ExportReport:
        from hir_exporters.obj.obj_exporter import ObjExporter

        (destination.parent / "lock").touch()
        (destination.parent / "lock").unlink()
        return ObjExporter(self.config).write(asset, destination, edit)


@hookimpl
def hir_register_exporters() -> list[Component]:
    return [Component("locked.obj", f"{__name__}:Expecting", ObjConfig, "OBJ with a lock.")]
