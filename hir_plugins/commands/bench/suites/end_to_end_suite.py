"""Whole runs: time and memory of each stage at growing numbers and sizes of photographs, and error on unseen views."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from hir_core.evaluation import EvaluationRequest, evaluate_run
from hir_core.pipeline import reconstruct
from hir_core.run.run_directory import STAGE_NAMES
from hir_plugins.commands.bench.bench_options import BenchOptions
from hir_plugins.commands.bench.inputs.bench_captures import capture_size, make_reduced_capture
from hir_plugins.commands.bench.results.bench_result import Case, Row, Timing

VIEW_COUNTS: Final = (20, 80, 300)
IMAGE_SIDES: Final = (256, 512, 1024)
EVALUATED_VIEWS: Final = 4
PATHS_PER_PIXEL: Final = 128


def end_to_end_rows(
    options: BenchOptions,
    view_counts: Sequence[int] = VIEW_COUNTS,
    image_sides: Sequence[int] = IMAGE_SIDES,
    settings: Sequence[str] = (),
) -> Iterator[Row]:
    """Rows for each capture, number of views and image size; an interrupted run is resumed.

    `settings` differ from those of the default preset, each as KEY=VALUE.
    """
    for path in options.captures:
        available_views, available_side = capture_size(path)
        previous: Timing | None = None
        for side in image_sides[:1] if options.quick else image_sides:
            for views in view_counts[:1] if options.quick else view_counts:
                case: Case = {"capture": path.name, "views": views, "image": side}
                if views > available_views or side > available_side:
                    note = f"the capture has {available_views} views of {available_side} pixels"
                    yield Row(case, "whole run", "ours", None, note=note)
                    continue
                if previous is not None and options.exceeds_limit(previous, 2):
                    yield Row(case, "whole run", "ours", None, note=options.omission_note(previous))
                    continue
                name = f"{path.name}_{views}_{side}"
                capture = make_reduced_capture(path, options.workspace / "captures" / name, views, side)
                rows = list(run_rows(capture, options.workspace / "runs" / name, case, options, settings))
                previous = rows[-1].timing
                yield from rows


def run_rows(capture: Path, folder: Path, case: Case, options: BenchOptions, settings: Sequence[str]) -> Iterator[Row]:
    """One row for each stage of a run, then one for the whole run with its error on unseen views."""
    assignments = ("export=[]", *settings)
    run = reconstruct(capture, folder, resume=True, plugins=options.plugins, assignments=assignments)
    stages = run.directory.read_timings()["stages"]
    timings = {
        name: _single_timing(
            float(stages[name]["seconds"]),
            float(stages[name]["processor_seconds"]),
            int(stages[name]["peak_memory_bytes"]),
        )
        for name in STAGE_NAMES
        if name in stages
    }
    for name, timing in timings.items():
        yield Row(case, name, "ours", timing)
    request = EvaluationRequest(options={"render_samples": PATHS_PER_PIXEL}, views=EVALUATED_VIEWS)
    psnr = evaluate_run(run.directory, request, options.plugins)["psnr"]
    total = _single_timing(
        sum(timing.median for timing in timings.values()),
        sum(timing.cpu for timing in timings.values()),
        max(timing.memory_bytes or 0 for timing in timings.values()),
    )
    errors = {"unseen dB, frame": psnr["frame"], "unseen dB, object": psnr["object"]}
    yield Row(case, "whole run", "ours", total, errors)


def _single_timing(seconds: float, cpu: float, memory_bytes: int) -> Timing:
    return Timing(seconds, seconds, seconds, 1, cpu, memory_bytes)
