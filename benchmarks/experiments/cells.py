"""One cell of a study: a run with its settings, what it gave, and how long it took; stored as one JSON file."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.experiments.folders import ROOT, WORK, shared
from benchmarks.experiments.rendered import rendered
from hir_core.run.machine import source_commit
from hir_plugins.commands.bench.inputs.bench_captures import make_reduced_capture, make_resized_capture

RESULTS = ROOT / "benchmarks" / "results" / "experiments"

EVALUATED_VIEWS = 8
PATHS = 128


@dataclass(frozen=True)
class Cell:
    """A run of `hir reconstruct` and its `hir evaluate`; cells with equal fields are one job, also across studies."""

    name: str
    capture: str
    """Path below HIR_SHARED/captures; or `made:` and the name of a capture that Blender renders (`rendered.py`)."""
    views: int = 80
    side: int = 256
    preset: str = "fast"
    settings: tuple[str, ...] = ()
    splits: tuple[str, ...] = ("test", "relight_0", "relight_1")
    evaluated: int = EVALUATED_VIEWS
    """Evaluated views of each split, at PATHS per pixel; 0 for all views, as `hir evaluate` does by default."""
    stretched: bool = False
    """Repeat views and enlarge pictures where the capture has fewer or smaller ones; for time and memory only."""

    @property
    def result(self) -> Path:
        return RESULTS / f"{self.name}.json"

    def stored(self) -> dict[str, Any] | None:
        """The stored result of this cell, or None where its settings differ."""
        if not self.result.is_file():
            return None
        document: dict[str, Any] = json.loads(self.result.read_text(encoding="utf-8"))
        return document if document["cell"] == json.loads(json.dumps(asdict(self))) else None

    def source(self) -> Path | None:
        """The capture, or None where it is not on this machine."""
        if self.capture.startswith("made:"):
            folder = rendered(self.capture.removeprefix("made:"))
        else:
            folder = shared() / "captures" / self.capture
        return folder if (folder / "transforms_train.json").is_file() else None

    def run(self, seconds: float | None = None) -> dict[str, Any]:
        """Fits, evaluates and stores; an interrupted run continues. Raises `TimeoutExpired` after `seconds`."""
        source = self.source()
        assert source is not None, f"{self.capture} is not there"
        make, kind = (make_resized_capture, "_stretched") if self.stretched else (make_reduced_capture, "")
        small = make(source, WORK / "captures" / f"{source.name}_{self.views}_{self.side}{kind}", self.views, self.side)
        folder = WORK / "runs" / self.name
        fit = ["reconstruct", small, "-o", folder, "--resume", "--preset", self.preset, "--set", "export=[]"]
        for setting in self.settings:
            fit += ["--set", setting]
        hir(*fit, seconds=seconds)
        figures = {}
        for split in self.splits:
            if (small / f"transforms_{split}.json").is_file():
                truth = ["--truth"] if split == "test" else []
                part = ["--views", str(self.evaluated), "--set", f"render_samples={PATHS}"] if self.evaluated else []
                hir("evaluate", folder, "--split", split, *part, *truth, seconds=seconds)
                found = json.loads((folder / "evaluation" / split / "metrics.json").read_text(encoding="utf-8"))
                figures[split] = {key: value for key, value in found.items() if key not in ("views", "run", "capture")}
        document = {"cell": asdict(self), "figures": figures} | facts(folder)
        self.result.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps(document, indent=1, sort_keys=True, ensure_ascii=False)
        self.result.write_text(text + "\n", encoding="utf-8")
        return document


def facts(folder: Path) -> dict[str, Any]:
    """Seconds and memory of each stage, the selected model; commit, date, machine and versions."""
    timings = json.loads((folder / "timings.json").read_text(encoding="utf-8"))
    run = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    stages = {
        name: {
            "seconds": stage["seconds"],
            "processor_seconds": stage["processor_seconds"],
            "peak_memory_bytes": stage["peak_memory_bytes"],
            "seconds_per_step": seconds_per_step(stage["progress"]),
        }
        for name, stage in timings["stages"].items()
    }
    return {
        "stages": stages,
        "seconds": sum(stage["seconds"] for stage in stages.values()),
        "processor_seconds": sum(stage["processor_seconds"] for stage in stages.values()),
        "peak_memory_bytes": max(stage["peak_memory_bytes"] for stage in stages.values()),
        "model": run["stages"]["reflectance"]["report"].get("model"),
        "triangles": run["stages"]["bake"]["report"].get("triangles"),
        "commit": source_commit(),
        "date": timings["finished"][:10],
        "machine": timings["machine"],
        "versions": run["versions"],
    }


def seconds_per_step(progress: list[list[float]]) -> float | None:
    """Mean seconds per step between the first and the last block of a loop; None for a single block."""
    if len(progress) < 2 or progress[-1][0] == progress[0][0]:
        return None
    last = next(seconds for step, seconds in progress if step == progress[-1][0])
    return (last - progress[0][1]) / (progress[-1][0] - progress[0][0])


def hir(*words: object, seconds: float | None = None) -> None:
    """Runs one `hir` command in a subprocess."""
    command = [sys.executable, "-m", "hir_core.cli", *map(str, words), "-q"]
    subprocess.run(command, check=True, cwd=ROOT, timeout=seconds, stdout=subprocess.DEVNULL)
