"""report.html from the files of a run. Nothing is rendered here."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hir_exporters.files.atomic import write_text_atomic

from hir_core.plugins.manager import PluginManager
from hir_core.plugins.progress import MODELS_COMPARED
from hir_core.report import (
    convergence,
    embedded_pictures,
    embedded_viewer,
    evaluation_tables,
    history_chart,
    model_selection_table,
    tables,
)
from hir_core.report.page_templates import read_asset, render
from hir_core.report.tiles import tiles
from hir_core.report.value_formatting import report_of
from hir_core.run.run_directory import RunDirectory, refuse_damaged_documents

MAP_NAMES = {"base_color": "base colour", "specular": "specular albedo"}
CONDITIONS = {
    "under_observed": "is seen by too few photographs",
    "in_shadow": "lies in shadow in all of them",
    "under_highlights": "is seen under highlights alone",
}


def refresh_page(directory: RunDirectory, plugins: PluginManager) -> Path:
    """Writes report.html; returns its path. `InputError` where a document of the run is damaged."""
    with refuse_damaged_documents(directory.path):
        text = _page(directory, plugins)
    path = directory.path / "report.html"
    write_text_atomic(path, text)
    return path


def _page(directory: RunDirectory, plugins: PluginManager) -> str:
    document, timings = directory.read_run(), directory.read_timings()
    return render(
        "page.html",
        css=read_asset("page.css"),
        js=read_asset("page.js"),
        title=document["capture"]["name"],
        lead=lead(document),
        tiles=tiles(document, timings),
        model=embedded_viewer.viewer(directory, plugins),
        comparison=embedded_pictures.comparison(directory),
        textures=embedded_pictures.textures(directory, report_of(document, "bake")),
        map_errors=embedded_pictures.map_errors(directory),
        map_error_sentence=map_error_sentence(report_of(document, "reflectance")),
        before_and_after=embedded_pictures.before_and_after(directory),
        history=history_chart.history_chart(convergence.history(directory, document, timings)),
        model_selection=model_selection_table.model_selection(
            document, convergence.milestones(timings, MODELS_COMPARED)
        ),
        curves=convergence.curves(directory),
        stages=tables.stages(document, timings),
        evaluations=evaluation_tables.evaluations(document),
        ground_truth=evaluation_tables.ground_truth(document),
        exports=tables.exports(document),
        warnings=tables.warnings(document),
        settings=tables.details("Settings", document["settings"]),
        machine=tables.details("Machine", timings.get("machine", {})),
        versions=tables.details("Versions", document["versions"]),
        plugins=tables.details("Plugins", document["plugins"]),
        version=document["versions"].get("hir", ""),
    )


def lead(document: Mapping[str, Any]) -> str:
    """Photographs, triangles, what gave the metres and corrected measured depths, preset, seed."""
    triangles = report_of(document, "bake").get("triangles")
    result = f"a mesh of {triangles:,} triangles with textures and light" if triangles else "an unfinished asset"
    count, preset = document["capture"]["views"], document["settings"]["preset"]
    initial = report_of(document, "initializer")
    scale, depths = initial.get("scale_from"), (initial.get("depth_scale") or {}).get("sentence")
    metres = f" Metres from {scale}." if scale else ""
    corrected = f" {depths[0].upper()}{depths[1:]}." if depths else ""
    return f"From {count} photographs: {result}.{metres}{corrected} Preset {preset}, seed {document['seed']}."


def map_error_sentence(report: Mapping[str, Any]) -> str:
    """Medians of the standard errors, and shares of the surface that are uncertain; empty without errors."""
    found = report.get("map_errors")
    if not found:
        return ""
    errors = [
        f"{MAP_NAMES.get(name, name)} ± {each['constant' if 'constant' in each else 'median']:.3f}"
        for name, each in found["standard_errors"].items()
    ]
    shares = [f"{share:.1%} {CONDITIONS.get(name, name)}" for name, share in found["shares"].items()]
    return f"Standard errors (median): {', '.join(errors)}. Of the surface, {', '.join(shares)}."
