"""Whole runs: seconds and memory of each stage as photographs grow in number and size, and what unseen views say."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from hir_core.evaluation import Question, evaluate_run
from hir_core.pipeline import reconstruct
from hir_core.run.run_directory import STAGES
from hir_plugins.commands.bench.bench_plan import Plan
from hir_plugins.commands.bench.inputs.bench_captures import extent, made_smaller
from hir_plugins.commands.bench.results.bench_result import Case, Row, Timing

VIEWS, SIDES = (20, 80, 300), (256, 512, 1024)
EVALUATED_VIEWS, PATHS = 4, 128


def end_to_end(plan: Plan) -> Iterator[Row]:
    """Rows for each capture, number of views and size that it has; a run that was stopped goes on."""
    for path in plan.captures:
        most, largest = extent(path)
        last: Timing | None = None
        for side in SIDES[:1] if plan.quick else SIDES:
            for views in VIEWS[:1] if plan.quick else VIEWS:
                case: Case = {"capture": path.name, "views": views, "image": side}
                if views > most or side > largest:
                    note = f"the capture has {most} views of {largest} pixels"
                    yield Row(case, "whole run", "ours", None, note=note)
                    continue
                if plan.too_slow(last, 2):
                    assert last is not None
                    yield Row(case, "whole run", "ours", None, note=plan.left_out(last))
                    continue
                name = f"{path.name}_{views}_{side}"
                small = made_smaller(path, plan.workspace / "captures" / name, views, side)
                rows = list(whole_run(small, plan.workspace / "runs" / name, case, plan))
                last = rows[-1].timing
                yield from rows


def whole_run(capture: Path, folder: Path, case: Case, plan: Plan) -> Iterator[Row]:
    """One row for each stage, then one for all."""
    run = reconstruct(capture, folder, resume=True, plugins=plan.plugins, assignments=("export=[]",))
    stages = run.directory.read_timings()["stages"]
    for name in (name for name in STAGES if name in stages):
        stage = stages[name]
        seconds, memory = float(stage["seconds"]), int(stage["peak_memory_bytes"])
        worked = float(stage["processor_seconds"])
        yield Row(case, name, "ours", Timing(seconds, seconds, seconds, 1, worked, memory))
    question = Question(options={"render_samples": PATHS}, views=EVALUATED_VIEWS)
    figures = evaluate_run(run.directory, question, plan.plugins)
    seconds, worked = (sum(float(stage[key]) for stage in stages.values()) for key in ("seconds", "processor_seconds"))
    memory = max(int(stage["peak_memory_bytes"]) for stage in stages.values())
    errors = {"unseen dB, frame": figures["psnr"]["frame"], "unseen dB, object": figures["psnr"]["object"]}
    yield Row(case, "whole run", "ours", Timing(seconds, seconds, seconds, 1, worked, memory), errors)
