"""Held-out dB of hypotheses after each round of the model selection; none is dropped.

`python -m benchmarks.hypothesis_curves CAPTURE…`, on the true mesh of captures of the materials benchmark. Prints one
line of JSON for each capture and seed; with `--table FILE…` the table of such lines, one column for each file.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.reflectance_task import task_of
from benchmarks.stored_rows import provenance
from hir_core.plugins.model_spec import ModelSpec
from hir_core.stages.held_out_views import model_selection_folds
from hir_core.stages.reflectance.selection.fit_sequence import FitSequence
from hir_core.stages.reflectance.selection.folded_fits import FoldedFits
from hir_core.stages.reflectance.selection.held_out_comparison import mean_decibels
from hir_core.stages.reflectance.selection.hypotheses import FRAMES, KINDS, hypothesis
from hir_core.stages.reflectance.selection.successive_halving import ROUNDS, SuccessiveHalving
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_model import Fit


def curves(path: Path, specs: Sequence[ModelSpec], seed: int, options: Mapping[str, Any]) -> dict[str, Any]:
    """Held-out dB of each hypothesis after each round, and what its fit has found."""
    task = task_of(path, downsample=1)
    began = time.process_time()
    solver = task.plugins.create("reflectance_renderer", "transport_ggx", dict(options), seed).prepare(
        task.start, task.train, 1
    )
    folds = FoldedFits(FitSequence(solver, lambda name, share: None), model_selection_folds(len(task.train.views)))
    rounds = SuccessiveHalving(folds, specs)
    hypotheses = {}
    for spec in specs:
        fit, held_out, between_lights = None, [], []
        for budget in ROUNDS:
            fit = rounds.fit_round(spec, fit, budget)
            held_out.append(round(fit.held_out_db, 2))
            between_lights.append(round(mean_decibels(fit.errors_between_lights), 2))
        assert fit is not None
        first = fit.fits[0]
        assert isinstance(first, Fit)
        values = first.parameters
        hypotheses[spec.name] = {
            "held_out_db": held_out,
            "between_lights_db": between_lights,
            "base_color": [round(value, 3) for value in values.base_color.detach().mean(dim=0).tolist()],
            "alpha": round(float(values.alpha.mean()), 3) if values.width is not None else None,
        }
    truth = json.loads((path / "truth.json").read_text(encoding="utf-8"))
    return {
        "capture": path.name,
        "kind": truth["kind"],
        "seed": seed,
        "options": dict(options),
        "hypotheses": hypotheses,
        "processor_seconds": round(time.process_time() - began),
        **provenance(),
    }


def table(files: Sequence[Path]) -> None:
    """Mean and standard deviation over seeds after the last round; one column for each file."""
    found: dict[tuple[str, str], dict[int, list[float]]] = defaultdict(lambda: defaultdict(list))
    for number, file in enumerate(files):
        for line in file.read_text(encoding="utf-8").splitlines():
            row = json.loads(line)
            for name, values in row["hypotheses"].items():
                found[row["capture"], name][number].append(values["held_out_db"][-1])
    print("| capture | hypothesis |" + "".join(f" {file.stem} |" for file in files) + " gain |")
    print("|---|---|" + "---|" * (len(files) + 1))
    for (capture, name), columns in sorted(found.items()):
        values = [columns.get(number, []) for number in range(len(files))]
        cells = [_mean_and_deviation(each) if each else "–" for each in values]
        gain = f"{np.mean(values[-1]) - np.mean(values[0]):+.2f}" if values[0] and values[-1] else "–"
        print(f"| {capture} | {name} | " + " | ".join(cells) + f" | {gain} |")


def _mean_and_deviation(values: Sequence[float]) -> str:
    return f"{np.mean(values):.2f}" + (f" ± {np.std(values, ddof=1):.2f}" if len(values) > 1 else "")


def _option(text: str) -> tuple[str, float]:
    name, _, number = text.partition("=")
    try:
        return name, float(number)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no option; write it as pixels_per_value=2.5") from None


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", type=Path, nargs="+", help="captures; files of an earlier run with --table")
    parser.add_argument("--kinds", default=",".join(KINDS), help="kinds of material, separated by commas")
    parser.add_argument("--frames", default=",".join(FRAMES), help="world, camera or both")
    parser.add_argument("--seeds", default="0")
    parser.add_argument(
        "--set",
        dest="options",
        type=_option,
        nargs="*",
        default=[],
        metavar="NAME=NUMBER",
        help="options of transport_ggx",
    )
    parser.add_argument("--table", action="store_true", help="print the table of stored lines, fit nothing")
    given = parser.parse_args()
    if given.table:
        table(given.paths)
        return
    torch.set_num_threads(1)
    options = dict(given.options)
    specs = [hypothesis(kind, frame) for frame in given.frames.split(",") for kind in given.kinds.split(",")]
    for path in given.paths:
        for seed in map(int, given.seeds.split(",")):
            print(json.dumps(curves(path, specs, seed, options)), flush=True)


if __name__ == "__main__":
    main()
