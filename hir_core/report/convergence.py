"""Quality of a run against time: the data of the report's charts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from hir_core.files.json_documents import read_json
from hir_core.plugins.progress import MODEL_FITTED
from hir_core.report.curve_svg import curve_svg
from hir_core.report.tables import notice
from hir_core.report.value_formatting import Document
from hir_core.run.progress_listener import read_curves
from hir_core.run.run_directory import STAGE_NAMES, RunDirectory

MAX_CURVES = 8
"""Curves per stage."""

TITLES = {
    "held_out": "held-out views, 1 − IoU",
    "gradient_norm": "gradient norm",
    "silhouette": "silhouettes, 1 − IoU",
    "held_out_psnr": "held-out views, dB",
    "loss": "loss",
}
"""Titles of scalars; the name of another scalar is its title."""


@dataclass(frozen=True)
class Series:
    """One line of the chart of PSNR against seconds."""

    label: str
    kind: str
    """`stages`, `held-out`, `fitted` or `unseen`: the style of the line."""
    seconds: tuple[float, ...]
    psnr: tuple[float, ...]


@dataclass(frozen=True)
class History:
    """PSNR over object pixels against seconds since the start of the run, and the end of each stage in seconds."""

    series: tuple[Series, ...]
    ends: tuple[tuple[str, float], ...]


def history(directory: RunDirectory, document: Document, timings: Document) -> History:
    """Every PSNR of the run that has a time."""
    start_of, ends, clock = {}, [], 0.0
    for stage in STAGE_NAMES:
        if stage in timings.get("stages", {}):
            start_of[stage] = clock
            clock += float(timings["stages"][stage]["seconds"])
            ends.append((stage, clock))
    end_of = dict(ends)
    lines = []
    path = directory.report / "views.json"
    shown = read_json(path).get("stages", {}) if path.exists() else {}
    points = [(end_of[stage], psnr) for stage, psnr in shown.items() if stage in end_of and psnr is not None]
    if points:
        points.sort()
        lines.append(_series("the photographs above, after each stage", "stages", points))
    seconds = milestones(timings, MODEL_FITTED)
    curves = read_curves(directory.stage("reflectance") / "curves.npz")
    found = curves.get("held_out_psnr")
    if found is not None and len(found[1]) == len(seconds):
        start = start_of.get("reflectance", 0.0)
        points = [(start + s, float(v)) for s, v in zip(seconds, found[1], strict=True)]
        lines.append(_series("held-out views during model selection", "held-out", points))
    unseen = document.get("metrics", {}).get("test", {}).get("psnr", {}).get("object")
    if unseen is not None and "reflectance" in end_of:
        lines.append(_series("unseen views", "unseen", [(end_of["reflectance"], float(unseen))]))
    return History(tuple(lines), tuple(ends))


def milestones(timings: Document, kind: str) -> list[float]:
    """Seconds since the start of the reflectance stage at which the steps of this kind ended."""
    entries = timings.get("stages", {}).get("reflectance", {}).get("milestones", [])
    return [float(seconds) for name, seconds in entries if name == kind]


def curves(directory: RunDirectory) -> Markup:
    """Small charts of the scalars of each stage."""
    charts = []
    for stage in STAGE_NAMES:
        found = read_curves(directory.stage(stage) / "curves.npz")
        for name in sorted(found)[:MAX_CURVES]:
            steps, values = cumulative_steps(found[name][0]), found[name][1]
            if len(values) > 1:
                charts.append(curve_svg(f"{stage}: {TITLES.get(name, name.replace('_', ' '))}", steps, values))
    return Markup("").join(charts) or notice("No stage reported a curve.")


def cumulative_steps(steps: NDArray[np.generic]) -> NDArray[np.float64]:
    """Steps of successive loops, where each loop continues the count of the loop before."""
    counted = np.asarray(steps, np.float64)
    change = np.diff(counted, prepend=counted[:1])
    return counted - np.cumsum(np.where(change < 0, change - 1, 0.0))


def _series(label: str, kind: str, points: Sequence[tuple[float, float]]) -> Series:
    return Series(label, kind, tuple(p[0] for p in points), tuple(p[1] for p in points))
