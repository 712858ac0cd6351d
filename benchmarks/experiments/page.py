"""docs/studies/paper_experiments.md from the stored results; nothing is run here."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from benchmarks.experiments.cells import EVALUATED_VIEWS, PATHS, RESULTS, ROOT
from benchmarks.experiments.scaling import growth_table, scaling_table
from benchmarks.experiments.studies import (
    BEST,
    IMAGES,
    LIGHTER,
    LIGHTS,
    PAPER_STEPS,
    PRESETS,
    SCALING,
    TERMS,
    Study,
)

PAGE = ROOT / "docs" / "studies" / "paper_experiments.md"
WHOLE_RUNS = RESULTS.parent / "whole_runs.json"
TEMPLATE = Path(__file__).with_name("paper_experiments.template.md")

PAPER_VIEWS, GEOMETRY_STEPS, REFLECTANCE_STEPS = 80, 200, 400
"""Steps for each view of the paper's two stages (METHOD, phases 2a and 2b)."""

Result = dict[str, Any]


def write_page() -> Path:
    """Writes the page; returns its path."""
    PAGE.write_text(page(), encoding="utf-8")
    return PAGE


def page() -> str:
    """The template with its tables."""
    parts = {
        "presets": presets_table(),
        "images": study_table(IMAGES),
        "terms": study_table(TERMS),
        "lights": study_table(LIGHTS),
        "scaling": "\n".join([SCALING.text, "", *scaling_table(), *not_run(SCALING), *growth_table()]),
        "lighter": ", ".join(f"`{setting}`" for setting in LIGHTER),
        "views": str(EVALUATED_VIEWS),
        "paths": str(PATHS),
        "lpips": lpips_sentence(),
    }
    text = TEMPLATE.read_text(encoding="utf-8")
    for name, part in parts.items():
        text = text.replace(f"<!--{name}-->", part)
    return text


def study_table(study: Study) -> str:
    """One row per cell, and the names of cells that have not run."""
    lines = [
        study.text,
        "",
        "| | unseen, frame / object | SSIM | LPIPS | FLIP | relit, object (scaled) | Chamfer, radii | normals | "
        "albedo (scaled) | seconds | model |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for label, cell in study.rows:
        result = cell.stored()
        lines.append(f"| {label} | " + " | ".join(cells_of(result)) + " |")
    return "\n".join([*lines, *not_run(study)])


def cells_of(result: Result | None) -> list[str]:
    """The figures of one row; dashes where a figure is missing."""
    if result is None:
        return ["–"] * 10
    test, relit = result["figures"].get("test", {}), result["figures"].get("relight_0", {})
    surface, albedo = test.get("surface", {}).get("seen", {}), test.get("albedo", {})
    psnr = test.get("psnr", {})
    both = f"{number(psnr.get('frame'), 2)} / {number(psnr.get('object'), 2)} dB"
    under = (
        f"{number(relit.get('psnr', {}).get('object'), 2)} ({number(relit.get('psnr_scaled', {}).get('object'), 2)})"
    )
    return [
        both,
        number(test.get("ssim"), 4),
        number(test.get("lpips"), 4),
        number(test.get("flip"), 4),
        under if relit else "–",
        number(surface.get("chamfer"), 5),
        number(surface.get("normal_error_deg"), 1, "°"),
        f"{number(albedo.get('psnr'), 1)} ({number(albedo.get('psnr_scaled'), 1)})" if albedo else "–",
        f"{result['seconds']:.0f}",
        str(result["model"]),
    ]


def presets_table() -> str:
    """LPIPS, SSIM, PSNR, training and rendering time, as the paper's Table 1 has them; the paper's own rows below."""
    lines = [
        "| | LPIPS | SSIM | PSNR, frame / object | training | rendering a view |",
        "|---|---|---|---|---|---|",
    ]
    for run in json.loads(WHOLE_RUNS.read_text(encoding="utf-8"))["runs"]:
        test, minutes = run["metrics"]["test"], sum(run["stages"].values()) / 60
        threads = f", {run['threads']} thread" + "s" * (run["threads"] != 1) if run["threads"] else ""
        lines.append(
            f"| ours, `{run['preset']}`: {run['capture']} | {number(test['lpips'], 4)} | {number(test['ssim'], 3)} "
            f"| {number(test['psnr']['frame'], 2)} / {number(test['psnr']['object'], 2)} | {minutes:.1f} min{threads} "
            f"| {number(run['seconds_per_view'], 1)} s |"
        )
    lines.append(f"| ours, `paper`: spot | – | – | – | {paper_time()} | |")
    lines.append(f"| ours, `best`: spot | {' | '.join(best_cells())} |")
    lines += [
        "| the paper: pig | 0.0124 | 0.975 | 35.01 / – | ~3 h, RTX 3090 | ~1 s |",
        "| the paper: pomegranate | 0.0230 | 0.903 | 34.28 / – | ~2.5 h, RTX 3090 | ~1 s |",
        "| the paper: hotdog | 0.0088 | 0.951 | 33.89 / – | ~3 h, RTX 3090 | ~1 s |",
    ]
    return "\n".join([*lines, *not_run(PRESETS)])


def best_cells() -> list[str]:
    """The columns of `presets_table` for the preset `best`."""
    result = BEST.stored()
    if result is None:
        return ["–", "–", "–", "not measured yet", ""]
    test, threads = result["figures"]["test"], result["machine"].get("threads")
    return [
        number(test["lpips"], 4),
        number(test["ssim"], 3),
        f"{number(test['psnr']['frame'], 2)} / {number(test['psnr']['object'], 2)}",
        f"{result['seconds'] / 60:.1f} min" + (f", {threads} thread" + "s" * (threads != 1) if threads else ""),
        f"{number(test['seconds_per_view'], 1)} s",
    ]


def paper_time() -> str:
    """The time of the paper's recipe, extrapolated from the seconds per step of a few steps."""
    result = PAPER_STEPS.stored()
    if result is None:
        return "not measured yet"
    geometry, reflectance = (result["stages"][name]["seconds_per_step"] for name in ("geometry", "reflectance"))
    if geometry is None or reflectance is None:
        return "not measured yet"
    hours = PAPER_VIEWS * (GEOMETRY_STEPS * geometry + REFLECTANCE_STEPS * reflectance) / 3600
    return (
        f"{hours:.0f} h, **extrapolated**: {PAPER_VIEWS * GEOMETRY_STEPS:,} steps of {geometry:.2f} s and "
        f"{PAPER_VIEWS * REFLECTANCE_STEPS:,} of {reflectance:.2f} s"
    )


def not_run(study: Study) -> list[str]:
    """A sentence that names cells without a result."""
    missing = [label for label, cell in study.rows if cell.stored() is None]
    return ["", f"Not run yet: {'; '.join(missing)}."] if missing else []


def lpips_sentence() -> str:
    """Why LPIPS is missing, as the evaluation reported it."""
    for study in (PRESETS, IMAGES, TERMS, LIGHTS):
        for _, cell in study.rows:
            found = (cell.stored() or {"figures": {}})["figures"].get("test", {}).get("lpips_missing")
            if found:
                return f"Empty cells of LPIPS: {found}."
    return ""


def number(value: float | None, digits: int, unit: str = "") -> str:
    """The value with `digits` decimals; a dash for None."""
    return "–" if value is None else f"{value:.{digits}f}{unit}"
