"""How much a run's result varies with its seed and its number of threads.

`python -m benchmarks.seeds_and_threads CAPTURE --workspace DIR [--seeds 0,1,2,3,4] [--threads 1,2] [-o FILE]`: each
`hir reconstruct` and `hir evaluate` in a process of its own. Finished runs are kept in the workspace and not repeated.
The result is written after every run: unseen dB, mesh error and selected model, with commit, date and machine.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.stored_rows import provenance
from hir_core.files.json_documents import read_json, write_json
from hir_core.run.machine import source_commit
from hir_plugins.commands.bench.materials_options import parse_seeds

RESULT = Path(__file__).resolve().parent / "results" / "seeds_and_threads.json"
PATHS = 128
LIMIT_DB = 0.2
"""Goal for the standard deviation of unseen views."""


def run(capture: Path, folder: Path, seed: int, threads: int) -> dict[str, Any]:
    """Figures of one run; a finished one is read."""
    finished = folder / "figures.json"
    if finished.is_file():
        return read_json(finished)
    environment = os.environ | {"OMP_NUM_THREADS": str(threads)}
    fit = ["reconstruct", str(capture), "-o", str(folder), "--resume", "--set", f"seed={seed}", "--set", "export=[]"]
    evaluation = ["evaluate", str(folder), "--split", "test", "--truth", "--set", f"render_samples={PATHS}"]
    for arguments in (fit, evaluation):
        subprocess.run([sys.executable, "-m", "hir_core.cli", *arguments, "-q"], check=True, env=environment)
    document = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    timings = json.loads((folder / "timings.json").read_text(encoding="utf-8"))
    test = document["metrics"]["test"]
    report = document["stages"]["reflectance"]["report"]
    figures = {
        "seed": seed,
        "threads": threads,
        "unseen": test["psnr"],
        "surface": test.get("surface"),
        "model": report["model"],
        "comparisons": report.get("comparisons", []),
        "processor_seconds": sum(stage["processor_seconds"] for stage in timings["stages"].values()),
        "commit": source_commit(),
    }
    write_json(finished, figures)
    return figures


def summary(runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Means and standard deviations of unseen views over all runs, and the models that were selected."""
    found: dict[str, Any] = {"runs": len(runs), "models": sorted({run["model"] for run in runs})}
    for part in ("frame", "object"):
        values = [run["unseen"][part] for run in runs]
        deviation = statistics.stdev(values) if len(values) > 1 else None
        found[part] = {
            "mean_db": statistics.mean(values),
            "standard_deviation_db": deviation,
            "range_db": max(values) - min(values),
            "within_goal": None if deviation is None else deviation <= LIMIT_DB,
        }
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--workspace", type=Path, required=True)
    parser.add_argument("--seeds", default="0,1,2,3,4")
    parser.add_argument("--threads", default="1,2")
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    options = parser.parse_args()
    runs = []
    for threads in parse_seeds(options.threads):
        for seed in parse_seeds(options.seeds):
            commit = source_commit()[:12] or "installed"
            folder = options.workspace / commit / f"{options.capture.name}_seed{seed}_threads{threads}"
            runs.append(run(options.capture, folder, seed, threads))
            document = {
                "capture": options.capture.name,
                "summary": summary(runs),
                "runs": runs,
                **provenance(),
            }
            write_json(options.output, document)
            print(json.dumps(document["summary"]), flush=True)


if __name__ == "__main__":
    main()
