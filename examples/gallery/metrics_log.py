"""An observer: every scalar of a run as a line of JSON, and a page with its curves that opens without a server.

hir reconstruct PHOTOS -o RUN --plugin metrics_log.py --set observers.metrics_log={}
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Annotated, Any, ClassVar

from annotated_types import Interval, Unit

from hir_core.plugins import hookimpl
from hir_core.plugins.options import build_options


@dataclass(frozen=True)
class Options:
    """Every scalar as a line of JSON in metrics/log.jsonl, and metrics/index.html with the curves."""

    width: Annotated[int, Interval(ge=100, le=4000), Unit("pixels")] = 640
    """Width of a curve."""
    points: Annotated[int, Interval(ge=2)] = 400
    """A curve is drawn from at most this many of its values; the log holds them all."""


class Log:
    """The curves of the run that is watched; None while none is."""

    options = Options()
    folder: Path | None = None
    curves: ClassVar[dict[tuple[str, str], list[tuple[int, float]]]] = {}


@hookimpl
def hir_register_observers() -> dict[str, type]:
    return {"metrics_log": Options}


@hookimpl
def hir_run_started(config: Any, run_folder: Path) -> None:
    table = config.observers.get("metrics_log", False)
    Log.folder, Log.curves = None, {}
    if table is not False:
        Log.options = build_options(Options, table, "observer 'metrics_log'")
        Log.folder = run_folder / "metrics"
        Log.folder.mkdir(exist_ok=True)
        (Log.folder / "log.jsonl").write_text("", encoding="utf-8")


@hookimpl
def hir_progress(progress: Any) -> None:
    for name, values in progress.scalars.items():
        first = progress.step - len(values) + 1
        _add(progress.stage, name, [(first + i, float(value)) for i, value in enumerate(values)])


@hookimpl
def hir_stage_finished(stage: str, report: Mapping[str, Any]) -> None:
    for name, value in report.items():
        if isinstance(value, float):
            _add(stage, f"report/{name}", [(0, value)])
    if Log.folder is not None:
        (Log.folder / "index.html").write_text(_page(), encoding="utf-8")


def _add(stage: str, name: str, values: list[tuple[int, float]]) -> None:
    if Log.folder is None:
        return
    Log.curves.setdefault((stage, name), []).extend(values)
    with (Log.folder / "log.jsonl").open("a", encoding="utf-8") as log:
        for step, value in values:
            log.write(json.dumps({"stage": stage, "name": name, "step": step, "value": value}) + "\n")


def _page() -> str:
    parts = ["<!doctype html><meta charset=utf-8><title>metrics</title><style>body{font:14px sans-serif}</style>"]
    for (stage, name), values in sorted(Log.curves.items()):
        last = f"{values[-1][1]:.6g}"
        parts.append(f"<h3>{escape(stage)}: {escape(name)} <small>last {last}</small></h3>{_curve(values)}")
    return "\n".join(parts) + "\n"


def _curve(values: list[tuple[int, float]]) -> str:
    finite = [(step, value) for step, value in values if abs(value) < float("inf")]
    shown = finite[:: max(1, len(finite) // Log.options.points)]
    if len(shown) < 2:
        return ""
    low, high = min(v for _, v in shown), max(v for _, v in shown)
    first, span = shown[0][0], max(shown[-1][0] - shown[0][0], 1)
    place = [
        f"{Log.options.width * (step - first) / span:.1f},{100 - 100 * (value - low) / ((high - low) or 1):.1f}"
        for step, value in shown
    ]
    box = f"viewBox='-2 -2 {Log.options.width + 4} 104' width='{Log.options.width}'"
    line = f"<polyline fill='none' stroke='#1565c0' points='{' '.join(place)}'/>"
    return f"<svg {box}>{line}</svg><div>{low:.6g} … {high:.6g}</div>"
