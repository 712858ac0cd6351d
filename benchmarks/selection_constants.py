"""Constants of the model selection, on selections of one capture that share their fits.

    python -m benchmarks.selection_constants NAME… --materials DIR [--only CAPTURE…] [--seeds 0,1,2]
    python -m benchmarks.selection_constants --table benchmarks/results/selection_constants.jsonl

Names are those of `benchmarks.default_values` whose constants act in the selection. On the true mesh of each capture of
the tuning half the model is selected with today's value and with each candidate. A fit depends on its arguments alone,
so a fit of the same model from the same fit is made once for all values: only where a constant changes a decision,
other fits follow. The selected model is fitted to all views, its textures are solved, and the scene is path traced in
unseen views and under other lights; the albedo's refinement by path tracing is left out. One line is stored for each
capture, seed and constant, with the selected models, commit, date and machine; stored lines are not measured again.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from statistics import mean
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.default_values import DEFAULT_VALUES, SELECTION, Value
from benchmarks.forced_fits import changed_constant, table
from benchmarks.reflectance_task import Task, task_of
from benchmarks.stored_rows import add_rows, provenance, stored_rows
from hir_core.config import ReflectanceSettings, load_config
from hir_core.plugins.interfaces import CheckpointLocation
from hir_core.plugins.model_spec import ModelSpec
from hir_core.stages.reflectance.selection import held_out_comparison
from hir_core.stages.reflectance.selection.exposure_selection import exposures_to_compare
from hir_core.stages.reflectance.selection.fit_sequence import FitSequence
from hir_core.stages.reflectance.selection.model_selection import select_model
from hir_core.stages.reflectance.selection.refinement_selection import Comparison, RefinementSelection
from hir_plugins.commands.bench.inputs.materials_captures import find_captures
from hir_plugins.commands.bench.materials_options import HALVES, parse_seeds
from hir_plugins.commands.bench.results.materials_summary import RELIT, UNSEEN
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_model import Fit
from hir_plugins.reflectance_renderers.transport_ggx.solver import TransportSolver

NAMES = (
    "required_standard_errors",
    "standard_errors_of_hypotheses",
    "drop_standard_errors",
    "standard_errors_of_normals",
)
STORE = Path("benchmarks/results/selection_constants.jsonl")
RENDERER = "transport_ggx"


@dataclass(eq=False)
class SharedFits:
    """Fits and held-out errors of one solver by their arguments."""

    fits: dict[tuple[Any, ...], Fit] = field(default_factory=dict)
    errors: dict[tuple[Any, ...], NDArray[np.float64]] = field(default_factory=dict)
    numbers: dict[int, int] = field(default_factory=dict)
    """Number of a fit, by its identity; all fits are kept, so that none is another one's successor in memory."""

    def number(self, fit: Fit | None) -> int | None:
        """Which of the fits it is; None for no fit."""
        return None if fit is None else self.numbers[id(fit)]


@contextmanager
def shared_fits() -> Iterator[SharedFits]:
    """Each fit of a solver is made once for equal arguments, and compared once with equal views."""
    fit_once, errors_once, shared = TransportSolver.fit, TransportSolver.errors, SharedFits()

    def fit(
        solver: TransportSolver,
        spec: ModelSpec,
        initial: Fit | None,
        views: Sequence[int],
        effort: float,
        report: Callable[[float], None],
        checkpoint: CheckpointLocation | None = None,
        pixel_share: float = 1.0,
    ) -> Fit:
        key = (id(solver), spec, shared.number(initial), tuple(views), effort, pixel_share)
        if key not in shared.fits:
            found = fit_once(solver, spec, initial, views, effort, report, checkpoint, pixel_share)
            shared.fits[key] = found
            shared.numbers[id(found)] = len(shared.numbers)
        report(1.0)
        return shared.fits[key]

    def errors(solver: TransportSolver, fitted: Fit, views: Sequence[int]) -> NDArray[np.float64]:
        key = (shared.number(fitted), tuple(views))
        if key not in shared.errors:
            shared.errors[key] = errors_once(solver, fitted, views)
        return shared.errors[key]

    TransportSolver.fit = fit  # type: ignore[method-assign]
    TransportSolver.errors = errors  # type: ignore[method-assign]
    try:
        yield shared
    finally:
        TransportSolver.fit = fit_once  # type: ignore[method-assign]
        TransportSolver.errors = errors_once  # type: ignore[method-assign]


@contextmanager
def changed(name: str, value: Value) -> Iterator[None]:
    """Another value of a constant of the selection, in default arguments, too."""
    constant = DEFAULT_VALUES[name].constant
    bound = [held_out_comparison.is_significant, RefinementSelection._compare]
    before = [function.__defaults__ for function in bound]
    with changed_constant(constant, value):
        if constant == f"{SELECTION}:REQUIRED_STANDARD_ERRORS":
            held_out_comparison.is_significant.__defaults__ = (value,)
            RefinementSelection._compare.__defaults__ = (False, value)
        try:
            yield
        finally:
            for function, defaults in zip(bound, before, strict=True):
                function.__defaults__ = defaults


class NoObserver:
    """Observes nothing."""

    def evaluated(self, held_out_db: float) -> None:
        """A fit."""

    def compared(self, comparison: Comparison) -> None:
        """A comparison."""


@dataclass(frozen=True)
class Outcome:
    """What a selection ended with."""

    model: str
    errors: Mapping[str, float]


@dataclass(eq=False)
class Selections:
    """Selections of one capture and seed; the figures of equal ends are measured once."""

    task: Task
    settings: ReflectanceSettings
    solver: TransportSolver
    shared: SharedFits
    outcomes: dict[int, Outcome] = field(default_factory=dict)

    def outcome(self) -> Outcome:
        """Selects the model with the constants as they are now."""
        capture = self.task.train
        views = range(len(capture.views))
        fits = FitSequence(self.solver, lambda name, share: None)
        exposures = exposures_to_compare(capture, self.settings, RENDERER, True)
        selection = select_model(fits, self.settings, len(views), NoObserver(), None, exposures, True)
        fit = self.solver.fit(selection.spec, selection.fit, views, 1.0, lambda share: None)
        number = self.shared.number(fit)
        assert number is not None
        if number not in self.outcomes:
            scene = self.solver.scene(fit, views, lambda share: None).scene
            errors = self.task.evaluator(scene, selection.spec.bounces)
            relit = [value for key, value in errors.items() if key.startswith("relight")]
            found = {UNSEEN: round(errors["unseen dB"], 4), RELIT: round(mean(relit), 4)}
            self.outcomes[number] = Outcome(selection.spec.name, found)
        return self.outcomes[number]


def rows_of(capture: Path, half: str, seed: int, names: Sequence[str]) -> list[dict[str, Any]]:
    """The lines of one capture and seed."""
    task = task_of(capture, downsample=1)
    settings = load_config(task.plugins).reflectance
    solver = task.plugins.create("reflectance_renderer", RENDERER, {}, seed).prepare(task.start, task.train, 1)
    assert isinstance(solver, TransportSolver)
    rows = []
    with shared_fits() as shared:
        selections = Selections(task, settings, solver, shared)
        for name in names:
            began = time.perf_counter()
            default, found = DEFAULT_VALUES[name], {}
            for value in (default.value, *default.candidates):
                with changed(name, value):
                    found[str(value)] = selections.outcome()
            rows.append(
                {
                    "capture": capture.name,
                    "half": half,
                    "seed": seed,
                    "constant": name,
                    "decibels": {value: dict(outcome.errors) for value, outcome in found.items()},
                    "models": {value: outcome.model for value, outcome in found.items()},
                    "seconds": round(time.perf_counter() - began, 1),
                    **provenance(),
                }
            )
    return rows


def changed_decisions(rows: Sequence[Mapping[str, Any]]) -> str:
    """Markdown: captures and seeds in which a candidate selects another model than today's value."""
    lines = ["| constant | candidate | capture | seed | today | with the candidate |", "|---" * 6 + "|"]
    for row in rows:
        today = row["models"][str(DEFAULT_VALUES[row["constant"]].value)]
        for value, model in row["models"].items():
            if model != today:
                lines.append(f"| {row['constant']} | {value} | {row['capture']} | {row['seed']} | {today} | {model} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"some of {', '.join(NAMES)}; all by default")
    parser.add_argument("--materials", type=Path, help="folder of `python -m benchmarks.materials make`")
    parser.add_argument("--only", nargs="*", default=(), help="names or numbers of captures")
    parser.add_argument("--seeds", default="0,1,2")
    parser.add_argument("--store", type=Path, default=STORE, help="file of stored lines")
    parser.add_argument("--table", type=Path, metavar="FILE", help="print the tables of stored lines, measure nothing")
    options = parser.parse_args()
    if options.table is not None:
        rows = stored_rows(options.table)
        print(table(rows, NAMES), changed_decisions(rows), sep="\n\n")
        return
    if options.materials is None:
        parser.error("name --materials, or --table")
    for name in options.names:
        if name not in NAMES:
            parser.error(f"{name} is not one of {', '.join(NAMES)}")
    names = options.names or NAMES
    known = {(row["capture"], row["seed"], row["constant"]) for row in stored_rows(options.store)}
    for seed in parse_seeds(options.seeds):
        for capture in find_captures(options.materials, (HALVES[0],), tuple(options.only)).captures:
            missing = [name for name in names if (capture.name, seed, name) not in known]
            if missing:
                add_rows(options.store, rows_of(capture.folder, capture.half, seed, missing))


if __name__ == "__main__":
    main()
