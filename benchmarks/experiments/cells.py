"""One cell of a study: a run with its settings, what it gave, and how long it took; kept as one JSON file."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.experiments.folders import ROOT, WORK, shared
from benchmarks.experiments.rendered import rendered
from hir_plugins.commands.bench.inputs.bench_captures import make_reduced_capture, make_resized_capture

RESULTS = ROOT / "benchmarks" / "results" / "experiments"

EVALUATED_VIEWS = 8
PATHS = 128


@dataclass(frozen=True)
class Cell:
    """A run of `hir reconstruct` and its `hir evaluate`; cells with equal fields are one job, whoever asks for them."""

    name: str
    capture: str
    """Below HIR_SHARED/captures; or `made:` and the name of one that Blender renders (`rendered.py`)."""
    views: int = 80
    side: int = 256
    preset: str = "fast"
    settings: tuple[str, ...] = ()
    splits: tuple[str, ...] = ("test", "relight_0", "relight_1")
    evaluated: int = EVALUATED_VIEWS
    """Views of each split that are judged, at PATHS; 0 for all of them, as `hir evaluate` does by default."""
    stretched: bool = False
    """Views repeated and pictures enlarged where the capture has fewer and smaller ones: for time and memory alone."""

    @property
    def result(self) -> Path:
        return RESULTS / f"{self.name}.json"

    def stored(self) -> dict[str, Any] | None:
        """What an earlier run of this very cell gave."""
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
        """Fits, evaluates and stores; a run that was stopped goes on. Raises `TimeoutExpired` after `seconds`."""
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
    """Seconds and memory of each stage, the model that was chosen, the machine and versions."""
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
        "machine": timings["machine"],
        "versions": run["versions"],
    }


def seconds_per_step(progress: list[list[float]]) -> float | None:
    """Of a loop, from its first block to its last: what comes before and after does not count; None for one block."""
    if len(progress) < 2 or progress[-1][0] == progress[0][0]:
        return None
    last = next(seconds for step, seconds in progress if step == progress[-1][0])
    return (last - progress[0][1]) / (progress[-1][0] - progress[0][0])


def hir(*words: object, seconds: float | None = None) -> None:
    """One command of ours, in a process of its own."""
    command = [sys.executable, "-m", "hir_core.cli", *map(str, words), "-q"]
    subprocess.run(command, check=True, cwd=ROOT, timeout=seconds, stdout=subprocess.DEVNULL)
