"""The report of a run: `report/*.png`, and the page `report.html`, which needs no other file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final

from hir_core.errors import InputError
from hir_core.files.file_checksums import changed_file, checksums, regular_files
from hir_core.files.json_documents import read_json, write_json
from hir_core.report.report_page import refresh_page
from hir_core.run.run_directory import RunDirectory

if TYPE_CHECKING:
    from hir_core.plugins.manager import PluginManager

__all__ = ["pictures_damage", "refresh_page", "write_report"]

CHECKSUMS: Final = "checksums.json"
"""Hashes of the pictures in `report/`."""


def write_report(
    directory: RunDirectory, plugins: PluginManager, on_message: Callable[[str], None] | None = None
) -> Path:
    """Renders the pictures and writes the page; returns its path."""
    from hir_core.report.rendered_pictures import write_pictures

    write_json(directory.report / "views.json", write_pictures(directory, plugins, on_message))
    files = regular_files(directory.report)
    write_json(directory.report / CHECKSUMS, {"files": checksums(directory.report, files)})
    return refresh_page(directory, plugins)


def pictures_damage(directory: RunDirectory, side: int) -> str | None:
    """Which picture of `report/` is missing, not as it was written, or for another `report_side`; None where all are
    right."""
    path = directory.report / CHECKSUMS
    if not path.exists():
        return f"{path} is missing"
    try:
        if read_json(directory.report / "views.json")["side"] != side:
            return "report_side was changed"
        files = read_json(path)["files"]
        return changed_file(directory.report, {str(name): str(written) for name, written in files.items()})
    except (InputError, KeyError, AttributeError):
        return f"{path} is damaged"
