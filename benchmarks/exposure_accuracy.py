"""How near first exposures are to the true ones, and what held-out views decide, on the true mesh of made captures.

    python -m benchmarks.exposure_accuracy CAPTURE… [--stops 1] [--white-balance 0.15] [--seed 0]

Brightness of each photograph changes by a factor of 2^(-stops…stops), red and blue by 1 ± white_balance; what exceeds 1
is clipped. With `--stops 0 --white-balance 0` the photographs stay as they are. Prints one line of JSON for each
capture; with `--table FILE…` the table of such lines.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.reflectance_task import task_of
from benchmarks.stored_rows import provenance
from hir_core.capture import Capture, Pixels, View
from hir_core.config import ReflectanceSettings
from hir_core.stages.held_out_views import model_selection_folds
from hir_core.stages.reflectance.selection.exposure_selection import select_exposures
from hir_core.stages.reflectance.selection.fit_sequence import FitSequence
from hir_core.stages.reflectance.selection.folded_fits import FoldedFits
from hir_core.stages.reflectance.selection.hypotheses import hypotheses
from hir_plugins.reflectance_renderers.transport_ggx.fit.initial.initial_exposures import initial_exposures
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.solver import TransportSolver

CHANGES = ("brightness", "white_balance")


def measured(path: Path, stops: float, white_balance: float, seed: int) -> dict[str, Any]:
    """Errors of first exposures in stops, and the decision before the hypotheses."""
    task = task_of(path, downsample=1)
    factors = drawn_factors(len(task.train.views), stops, white_balance, seed)
    capture = exposed(task.train, factors)
    solver = task.plugins.create("reflectance_renderer", "transport_ggx", {}, seed).prepare(task.start, capture, 1)
    assert isinstance(solver, TransportSolver)
    folds = model_selection_folds(len(capture.views))
    training = list(folds[0][0])
    positions = np.stack([camera.center for camera in capture.cameras])
    began = time.process_time()
    found = initial_exposures(
        transport_of(solver).surface,
        solver._pixels.of(training),
        positions,
    ).numpy()
    seconds = time.process_time() - began
    error = found[training] / np.log(2) - np.log2(factors[training])
    error -= error.mean(axis=0)
    began = time.process_time()
    fits = FoldedFits(FitSequence(solver, lambda name, share: None), folds, positions)
    selection = select_exposures(fits, hypotheses(ReflectanceSettings()), False)
    return {
        "capture": path.name,
        "kind": json.loads((path / "truth.json").read_text(encoding="utf-8"))["kind"],
        "half": path.parent.name,
        "stops": stops,
        "white_balance": white_balance,
        "seed": seed,
        "error_brightness_stops": round(float(error[:, 1].std()), 4),
        "error_white_balance_stops": round(float((error[:, [0, 2]] - error[:, 1:2]).std()), 4),
        "seconds": round(seconds, 2),
        "selected": selection.exposures,
        "gain_db": None if selection.gain_db is None else round(selection.gain_db, 3),
        "standard_error_db": None if selection.standard_error_db is None else round(selection.standard_error_db, 3),
        "decision_seconds": round(time.process_time() - began, 1),
        **provenance(),
    }


def transport_of(solver: TransportSolver) -> Transport:
    """The cached transport of a solver."""
    return solver._transport


def drawn_factors(views: int, stops: float, white_balance: float, seed: int) -> NDArray[np.float64]:
    """Factors (views, 3) of red, green and blue."""
    rng = np.random.default_rng(seed)
    factors = np.exp2(rng.uniform(-stops, stops, (views, 1))) * np.ones(3)
    factors[:, [0, 2]] *= 1 + rng.uniform(-white_balance, white_balance, (views, 2))
    return factors


def exposed(capture: Capture, factors: NDArray[np.float64]) -> Capture:
    """The photographs times their factors, clipped at 1."""

    def read(view: View, factor: NDArray[np.float64]) -> Callable[[], Pixels]:
        def changed() -> Pixels:
            pixels = view.read()
            color = (pixels.color_linear * factor).astype(np.float32)
            clipped = pixels.saturated | (color >= 1).any(axis=2)
            return replace(pixels, color_linear=np.minimum(color, 1), saturated=clipped)

        return changed

    views = (replace(view, read=read(view, row)) for view, row in zip(capture.views, factors, strict=True))
    return replace(capture, views=tuple(views))


def table(files: Sequence[Path]) -> None:
    """Means over seeds, and standard deviations; one row for each capture and change of exposures."""
    found: dict[tuple[str, str, str, float], list[dict[str, Any]]] = defaultdict(list)
    for file in files:
        for line in file.read_text(encoding="utf-8").splitlines():
            row = json.loads(line)
            found[row["half"], row["capture"], row["kind"], row["stops"]].append(row)
    print("| capture | half | material | change | error of brightness | of white balance | fitted | gain, dB |")
    print("|---|---|---|---|---|---|---|---|")
    for (half, capture, kind, stops), rows in sorted(found.items()):
        errors = [_mean_and_deviation([row[f"error_{of}_stops"] for row in rows]) for of in CHANGES]
        fitted = sum(row["selected"] == "fitted" for row in rows)
        gains = [row["gain_db"] for row in rows if row["gain_db"] is not None]
        gain = f"{np.mean(gains):+.2f}" if gains else "–"
        change = f"±{stops:g} stops" if stops else "none"
        print("|", " | ".join([capture, half, kind, change, *errors, f"{fitted}/{len(rows)}", gain]), "|")


def _mean_and_deviation(values: Sequence[float]) -> str:
    deviation = f" ± {np.std(values, ddof=1):.3f}" if len(values) > 1 else ""
    return f"{np.mean(values):.3f}{deviation}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", type=Path, nargs="+", help="captures; with --table files of lines")
    parser.add_argument("--stops", type=float, default=1.0, help="largest change of brightness")
    parser.add_argument("--white-balance", type=float, default=0.15, help="largest change of red and blue")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--table", action="store_true")
    given = parser.parse_args()
    if given.table:
        return table(given.files)
    for path in given.files:
        print(json.dumps(measured(path, given.stops, given.white_balance, given.seed)), flush=True)


if __name__ == "__main__":
    main()
