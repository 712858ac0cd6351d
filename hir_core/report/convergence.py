"""What a run's stages came to, and when: the data of the report's plots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hir_core.files.json_documents import read_json
from hir_core.plugins.progress import MODEL_FITTED
from hir_core.report.curve_svg import curve_svg
from hir_core.run.progress_listener import read_curves
from hir_core.run.run_directory import STAGE_NAMES, RunDirectory

SHOWN_CURVES = 8

NAMES = {
    "held_out": "held-out views, 1 − IoU",
    "gradient_norm": "gradient norm",
    "silhouette": "silhouettes, 1 − IoU",
    "held_out_psnr": "held-out views, dB",
    "training_psnr": "fitted views, dB",
    "loss": "loss",
}
"""Words for scalars whose names do not speak for themselves."""


@dataclass(frozen=True)
class Series:
    """Points of one line of the plot of PSNR against seconds."""

    label: str
    kind: str
    """`stages`, `held-out`, `fitted` or `unseen`: how it is drawn."""
    seconds: tuple[float, ...]
    psnr: tuple[float, ...]


@dataclass(frozen=True)
class History:
    """PSNR over object pixels against seconds since the run began, and when each stage ended."""

    series: tuple[Series, ...]
    ends: tuple[tuple[str, float], ...]


def history(directory: RunDirectory, document: Mapping[str, Any], timings: Mapping[str, Any]) -> History:
    """All that the folder knows of quality over time."""
    starts, ends, clock = {}, [], 0.0
    for stage in STAGE_NAMES:
        if stage in timings.get("stages", {}):
            starts[stage] = clock
            clock += float(timings["stages"][stage]["seconds"])
            ends.append((stage, clock))
    end_of = dict(ends)
    found = []
    path = directory.report / "views.json"
    shown = read_json(path).get("stages", {}) if path.exists() else {}
    points = [(end_of[stage], psnr) for stage, psnr in shown.items() if stage in end_of and psnr is not None]
    if points:
        points.sort()
        found.append(_series("the photographs shown, after each stage", "stages", points))
    seconds = milestones(timings, MODEL_FITTED)
    curves = read_curves(directory.stage("reflectance") / "curves.npz")
    for name, kind, label in (
        ("held_out_psnr", "held-out", "views held out while models are chosen"),
        ("training_psnr", "fitted", "views that they were fitted to"),
    ):
        if name in curves and len(curves[name][1]) == len(seconds):
            began = starts.get("reflectance", 0.0)
            found.append(
                _series(label, kind, [(began + s, float(v)) for s, v in zip(seconds, curves[name][1], strict=True)])
            )
    unseen = document.get("metrics", {}).get("test", {}).get("psnr", {}).get("object")
    if unseen is not None and "reflectance" in end_of:
        found.append(_series("unseen views", "unseen", [(end_of["reflectance"], float(unseen))]))
    return History(tuple(found), tuple(ends))


def milestones(timings: Mapping[str, Any], kind: str) -> list[float]:
    """Seconds since the reflectance stage began at which each thing of this kind ended; empty where none did."""
    told = timings.get("stages", {}).get("reflectance", {}).get("milestones", [])
    return [float(seconds) for name, seconds in told if name == kind]


def curves(directory: RunDirectory) -> str:
    """Small plots of each stage's scalars."""
    shown = []
    for stage in STAGE_NAMES:
        found = read_curves(directory.stage(stage) / "curves.npz")
        for name in sorted(found)[:SHOWN_CURVES]:
            steps, values = going_on(found[name][0]), found[name][1]
            if len(values) > 1:
                shown.append(curve_svg(f"{stage}: {NAMES.get(name, name.replace('_', ' '))}", steps, values))
    return "".join(shown) or "<p class=quiet>No stage reported a curve.</p>"


def going_on(steps: NDArray[np.generic]) -> NDArray[np.float64]:
    """Steps of loops that ran one after the other, each counted from the end of the one before."""
    counted = np.asarray(steps, np.float64)
    back = np.diff(counted, prepend=counted[:1])
    return counted - np.cumsum(np.where(back < 0, back - 1, 0.0))


def _series(label: str, kind: str, points: Sequence[tuple[float, float]]) -> Series:
    return Series(label, kind, tuple(p[0] for p in points), tuple(p[1] for p in points))
