"""The report of a run: `report/*.png`, and the page `report.html`, which needs no other file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from hir_core.files.json_documents import write_json
from hir_core.report.report_page import refresh_page
from hir_core.run.run_directory import RunDirectory

if TYPE_CHECKING:
    from hir_core.plugins.manager import PluginManager

__all__ = ["refresh_page", "write_report"]


def write_report(
    directory: RunDirectory, plugins: PluginManager, on_message: Callable[[str], None] | None = None
) -> Path:
    """Renders the pictures and writes the page; returns its path."""
    from hir_core.report.rendered_pictures import write_pictures

    write_json(directory.report / "views.json", write_pictures(directory, plugins, on_message))
    return refresh_page(directory, plugins)
