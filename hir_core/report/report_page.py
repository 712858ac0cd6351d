"""report.html, put together from what lies in a run's folder; nothing is rendered here."""

from __future__ import annotations

import html
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from hir_exporters.files.atomic import write_text_atomic

from hir_core.plugins.manager import PluginManager
from hir_core.plugins.progress import MODELS_COMPARED
from hir_core.report import convergence, embedded_pictures, embedded_viewer, history_chart, tables
from hir_core.run.run_directory import RunDirectory, damage_told


def refresh_page(directory: RunDirectory, plugins: PluginManager) -> Path:
    """Writes report.html; returns its path. Damaged documents are an `InputError`."""
    with damage_told(directory.path):
        text = _page(directory, plugins)
    path = directory.path / "report.html"
    write_text_atomic(path, text)
    return path


def _page(directory: RunDirectory, plugins: PluginManager) -> str:
    document, timings = directory.read_run(), directory.read_timings()
    assets = files("hir_core.report") / "template"
    parts = {
        "css": (assets / "page.css").read_text(encoding="utf-8"),
        "js": (assets / "page.js").read_text(encoding="utf-8"),
        "title": html.escape(str(document["capture"]["name"])),
        "lead": _lead(document),
        "figures": tables.tiles(document, timings),
        "model": embedded_viewer.viewer(directory, plugins),
        "comparison": embedded_pictures.comparison(directory),
        "textures": embedded_pictures.textures(directory, tables.report_of(document, "bake")),
        "history": history_chart.history_chart(convergence.history(directory, document, timings)),
        "ladder": tables.ladder(document, convergence.milestones(timings, MODELS_COMPARED)),
        "curves": convergence.curves(directory),
        "stages": tables.stages(document, timings),
        "evaluations": tables.evaluations(document),
        "truth": tables.truth(document),
        "exports": tables.exports(document),
        "warnings": tables.warnings(document),
        "settings": tables.details("Settings", document["settings"]),
        "machine": tables.details("Machine", timings.get("machine", {})),
        "versions": tables.details("Versions", document["versions"]),
        "plugins": tables.details("Plugins", document["plugins"]),
        "version": html.escape(str(document["versions"].get("hir", ""))),
    }
    page = (assets / "page.html").read_text(encoding="utf-8")
    for name, text in parts.items():
        page = page.replace(f"<!--{name}-->", text)
    return page


def _lead(document: Mapping[str, Any]) -> str:
    baked: Mapping[str, Any] = document["stages"].get("bake", {}).get("report", {})
    triangles = baked.get("triangles")
    made = f"a mesh of {triangles:,} triangles with its textures and light" if triangles else "an unfinished asset"
    count, preset = document["capture"]["views"], document["settings"]["preset"]
    return html.escape(f"{count} photographs became {made}. Preset {preset}, seed {document['seed']}.")
