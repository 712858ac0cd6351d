"""Whole runs with the default settings on objects of the materials benchmark, where brightness is in question.

    python -m benchmarks.brightness_runs card 16_block_plastic_satin_windows … --workspace DIR [--store FILE]
    python -m benchmarks.brightness_runs --table FILE

`plain`: the capture as it is. `changed`: its photographs with other exposures (`benchmarks.changed_exposures`).
`card`: with the card of `hir card` beside the object (`benchmarks.card_capture`). `lamp`: under a lamp that the camera
carries, at distances that differ by two (`benchmarks.lamp_capture`). Captures that the workspace lacks are rendered
first. Unseen views and relit ones of the first three are those of the capture. One line is stored for each run, with
commit, date and machine.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.card_capture import MARKER_SIDE
from benchmarks.hir_command import hir
from benchmarks.materials.recipes import Recipe, recipes
from benchmarks.stored_rows import add_rows, run_arguments
from hir_core.run.capture_store import read_cameras
from hir_core.run.machine import source_commit
from hir_core.run.run_directory import RunDirectory

CASES = "plain", "changed", "card", "lamp"
RELIGHTS = "relight_0", "relight_1"
MARKER_METRES = 0.05


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("case", nargs="?", choices=CASES)
    parser.add_argument("recipes", nargs="*", choices=[*(each.name for each in recipes()), []], metavar="RECIPE")
    given = run_arguments(parser, Path("brightness_runs.jsonl"), table)
    for recipe in (each for each in recipes() if each.name in given.recipes):
        capture = made_capture(recipe, given.case, given.workspace, given.variant)
        for seed in () if given.make_only else given.seeds:
            add_rows(given.store, [measured(recipe, given.case, capture, seed)])


def made_capture(recipe: Recipe, case: str, workspace: Path, variant: str) -> Path:
    """The folder of a capture; rendered where it is missing or unfinished."""
    workspace.mkdir(parents=True, exist_ok=True)
    if case == "lamp":
        return _made(workspace / "lamp" / recipe.name, "benchmarks.lamp_capture", recipe.name, "--variant", variant)
    _program("benchmarks.materials", "make", workspace, "--only", recipe.name, "--variant", variant)
    plain = workspace / recipe.half / recipe.name
    if case == "plain":
        return plain
    capture = workspace / case / recipe.name
    if case == "card":
        return _made(capture, "benchmarks.card_capture", plain, "--variant", variant)
    return _made(capture, "benchmarks.changed_exposures", plain)


def _made(capture: Path, module: str, source: str | Path, *options: str) -> Path:
    partial = capture.with_name(capture.name + ".partial")
    if not capture.is_dir():
        shutil.rmtree(partial, ignore_errors=True)
        partial.parent.mkdir(parents=True, exist_ok=True)
        _program(module, source, partial, *options)
        partial.rename(capture)
    return capture


def _program(module: str, *words: str | Path) -> None:
    subprocess.run([sys.executable, "-m", module, *words], check=True)


def measured(recipe: Recipe, case: str, capture: Path, seed: int) -> dict[str, Any]:
    """The line of one run; an earlier run is replaced."""
    run = capture.with_name(f"{capture.name}.run_{seed}")
    shutil.rmtree(run, ignore_errors=True)
    settings = ("--set", f"initializer.fiducial_markers.side={MARKER_METRES}") if case == "card" else ()
    seconds = hir("reconstruct", capture, "-o", run, "-q", "--seed", str(seed), "--set", "export=[]", *settings)
    splits = ("test",) if case == "lamp" else ("test", *RELIGHTS)
    found = {}
    for split in splits:
        hir("evaluate", run, "--split", split, "-q")
        found[split] = json.loads((run / "evaluation" / split / "metrics.json").read_text())
    stages = json.loads((run / "run.json").read_text())["stages"]
    report = stages["reflectance"]["report"]
    exposures, lamp = report.get("exposures"), report.get("lamp")
    return {
        "recipe": recipe.name,
        "half": recipe.half,
        "case": case,
        "seed": seed,
        "seconds": round(seconds, 1),
        "model": report["model"],
        "light_frame": report["light_frame"],
        "exposures": None if exposures is None else exposures["selected"],
        "lamp": None if lamp is None else lamp["took_part"],
        "unseen": found["test"]["psnr"],
        "unseen_scaled": found["test"]["psnr_scaled"],
        "relit": {light: found[light]["psnr"] for light in splits[1:]},
        "relit_scaled": {light: found[light]["psnr_scaled"] for light in splits[1:]},
        "size_error": size_error(capture, run) if case == "card" else None,
        "commit": source_commit(),
        "date": datetime.now(UTC).date().isoformat(),
        "machine": json.loads((run / "timings.json").read_text())["machine"],
    }


def size_error(capture: Path, run: Path) -> float:
    """Relative error of the metres of a unit, from the distances between cameras."""
    frames = json.loads((capture / "transforms_train.json").read_text())["frames"]
    given = {Path(frame["file_path"]).stem: np.array(frame["transform_matrix"])[:3, 3] for frame in frames}
    found = {Path(name).stem: camera.center for name, camera in read_cameras(RunDirectory(run).cameras).items()}
    names = sorted(given.keys() & found.keys())
    ratio = _mean_distance([found[name] for name in names]) / _mean_distance([given[name] for name in names])
    return round(float(ratio / (MARKER_METRES / MARKER_SIDE)) - 1, 6)


def _mean_distance(centers: Sequence[Any]) -> float:
    points = np.stack(centers)
    return float(np.linalg.norm(points - points.mean(axis=0), axis=1).mean())


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown: one run a line; relit figures over the frame, as they are and scaled, the mean of both lights."""
    lines = [
        "| case | object | seed | unseen (object) | relit | scaled | size | exposures | light | model | commit |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in sorted(rows, key=lambda each: (CASES.index(each["case"]), each["recipe"], each["seed"])):
        relit = [
            f"{np.mean([values['frame'] for values in row[key].values()]):.1f}" if row[key] else "–"
            for key in ("relit", "relit_scaled")
        ]
        size = "–" if row["size_error"] is None else f"{100 * row['size_error']:+.2f} %"
        cells = [row["case"], row["recipe"], str(row["seed"])]
        cells += [f"{row['unseen']['frame']:.1f} ({row['unseen']['object']:.1f})", *relit, size]
        cells += [row["exposures"] or "equal", row["light_frame"], row["model"], row["commit"][:7]]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
