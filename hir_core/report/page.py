"""report.html, put together from what lies in a run's folder; nothing is rendered here."""

from __future__ import annotations

import html
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from hir_exporters.atomic import write_text_atomic

from hir_core.progress import VOTE
from hir_core.report import charts, convergence, figures, model, pictures
from hir_core.run_directory import RunDirectory, damage_told


def refresh_page(directory: RunDirectory) -> Path:
    """Writes report.html; returns its path. Damaged documents are an `InputError`."""
    with damage_told(directory.path):
        text = _page(directory)
    path = directory.path / "report.html"
    write_text_atomic(path, text)
    return path


def _page(directory: RunDirectory) -> str:
    document, timings = directory.read_run(), directory.read_timings()
    assets = files("hir_core") / "report_page"
    parts = {
        "css": (assets / "page.css").read_text(encoding="utf-8"),
        "js": (assets / "page.js").read_text(encoding="utf-8"),
        "title": html.escape(str(document["capture"]["name"])),
        "lead": _lead(document),
        "figures": figures.tiles(document, timings),
        "model": model.viewer(directory),
        "comparison": pictures.comparison(directory),
        "textures": pictures.textures(directory, figures.report_of(document, "bake")),
        "history": charts.history_chart(convergence.history(directory, document, timings)),
        "ladder": figures.ladder(document, convergence.milestones(timings, VOTE)),
        "curves": convergence.curves(directory),
        "stages": figures.stages(document, timings),
        "evaluations": figures.evaluations(document),
        "truth": figures.truth(document),
        "exports": figures.exports(document),
        "warnings": figures.warnings(document),
        "settings": figures.details("Settings", document["settings"]),
        "machine": figures.details("Machine", timings.get("machine", {})),
        "versions": figures.details("Versions", document["versions"]),
        "plugins": figures.details("Plugins", document["plugins"]),
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
