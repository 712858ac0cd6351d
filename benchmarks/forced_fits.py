"""Constants of the texture solve and of the fitted light, on fits that are forced to the true kind of material.

    python -m benchmarks.forced_fits NAME… --materials DIR --workspace DIR [--only CAPTURE…] [--seeds 0,1,2]
    python -m benchmarks.forced_fits --table benchmarks/results/forced_fits.jsonl

Names are some of those of `benchmarks.default_values`: each candidate beside today's value on captures of the tuning
half, with true mesh, kind and light frame. A model selection would cost ten times as much, and its decisions would hide
what a constant of the solver does. Runs are those of `hir reconstruct`; only values that act after the fit at vertices
share that fit. `--half validation` measures today's values alone. One line is stored for each capture, seed and
constant, with commit, date and machine; a line that is stored already is not measured again. Gains are paired inside a
line, so lines of different commits may stand in one table.
"""

from __future__ import annotations

import argparse
import hashlib
import statistics
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any, get_args, get_type_hints

from benchmarks.default_values import DEFAULT_VALUES, MEASURES, Value, gain_of
from benchmarks.stored_rows import add_rows, provenance, stored_rows
from hir_core.config import ReflectanceSettings
from hir_core.errors import ConfigError
from hir_core.plugins.interfaces import CheckpointLocation
from hir_core.plugins.manager import PluginManager
from hir_core.plugins.model_spec import ModelSpec
from hir_plugins.commands.bench.inputs.materials_captures import MaterialsCapture, find_captures
from hir_plugins.commands.bench.materials_options import HALVES, parse_seeds
from hir_plugins.commands.bench.suites.forced_hypotheses import forcing_settings
from hir_plugins.commands.bench.suites.materials_run import RunFigures, current_key, run_figures
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_model import Fit
from hir_plugins.reflectance_renderers.transport_ggx.solver import TransportSolver

NAMES = ("light_whiteness", "light_smoothness", "texel_prior_weight", "texel_smoothness", "texture_size")
"""Settings of the fit, and values that act after it: a constant of the fit itself must not share fits."""
STORE = Path("benchmarks/results/forced_fits.jsonl")
MODEL = "specular"
"""One lobe and an albedo texture; maps of the lobe are not needed to judge the albedo's constants."""


def true_settings(capture: MaterialsCapture) -> tuple[str, ...]:
    """The settings that force a fit to what is true of a capture."""
    kinds = forcing_settings(frozenset(get_args(get_type_hints(ReflectanceSettings)["brdf"])))
    return *kinds[capture.kind], f"reflectance.model={MODEL}", f"reflectance.light_frame={capture.light_frame}"


@contextmanager
def shared_fits() -> Iterator[dict[str, Fit]]:
    """Fits at vertices that start from nothing are made once for the same mesh, options, model and views.

    What a fit depends on beside these is the capture; two captures have different meshes.
    """
    original, known = TransportSolver.fit, dict[str, Fit]()

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
        if initial is not None:
            return original(solver, spec, initial, views, effort, report, checkpoint, pixel_share)
        mesh = hashlib.blake2b(solver._transport.surface.positions.cpu().numpy().tobytes()).hexdigest()
        key = repr((mesh, solver._options, spec, tuple(views), effort, pixel_share))
        if key not in known:
            known[key] = original(solver, spec, None, views, effort, report, checkpoint, pixel_share)
        return known[key]

    TransportSolver.fit = fit  # type: ignore[method-assign]
    try:
        yield known
    finally:
        TransportSolver.fit = original  # type: ignore[method-assign]


@contextmanager
def changed_constant(constant: str, value: Value) -> Iterator[None]:
    """Sets `package:NAME` in every module of the package that defines or imports it; `ConfigError` where none does."""
    package, _, name = constant.partition(":")
    for module in iter_modules(import_module(package).__path__, f"{package}."):
        import_module(module.name)
    holders = [m for key, m in sys.modules.items() if key.startswith(package) and hasattr(m, name)]
    if not holders:
        raise ConfigError(f"{package}: no module has {name}")
    before = getattr(holders[0], name)
    try:
        for holder in holders:
            setattr(holder, name, value)
        yield
    finally:
        for holder in holders:
            setattr(holder, name, before)


def run_with(
    name: str, value: Value, capture: MaterialsCapture, seed: int, workspace: Path, plugins: PluginManager
) -> RunFigures:
    """The figures of a forced fit with another value of one constant; today's value is measured once for all names."""
    default = DEFAULT_VALUES[name]
    settings = true_settings(capture)
    if value == default.value:
        return run_figures(current_key(capture, "truth", seed, settings), capture, workspace / "today", plugins)
    folder = workspace / f"{name}_{value}"
    if default.setting:
        key = current_key(capture, "truth", seed, (*settings, f"{default.setting}={value}"))
        return run_figures(key, capture, folder, plugins)
    with changed_constant(default.constant, value):
        return run_figures(current_key(capture, "truth", seed, settings), capture, folder, plugins)


def measured(
    name: str,
    values: Sequence[Value],
    capture: MaterialsCapture,
    seed: int,
    workspace: Path,
    plugins: PluginManager,
) -> dict[str, Any]:
    """The line of one capture, seed and constant: decibels with each value."""
    decibels: dict[str, dict[str, float]] = {}
    for value in values:
        figures = run_with(name, value, capture, seed, workspace, plugins)
        decibels[str(value)] = {error: round(figures.errors[error], 4) for error in MEASURES}
    return {
        "capture": capture.name,
        "half": capture.half,
        "seed": seed,
        "constant": name,
        "decibels": decibels,
        "fit": "forced to the true kind and light frame, true mesh",
        **provenance(),
    }


def table(rows: Sequence[Mapping[str, Any]], names: Sequence[str] = NAMES) -> str:
    """Markdown: gains of each candidate over today's value for each capture, their mean and the verdict."""
    lines = []
    for name in names:
        default = DEFAULT_VALUES[name]
        chosen = [row for row in rows if row["constant"] == name and row["half"] == HALVES[0]]
        captures = sorted({row["capture"] for row in chosen})
        if not captures:
            continue
        lines += [
            "| constant | candidate | measure | "
            + " | ".join(c.partition("_")[0] for c in captures)
            + " | mean | verdict |"
        ]
        lines += ["|---" * (len(captures) + 5) + "|"]
        for value in default.candidates:
            for error in MEASURES:
                today, candidate = (
                    {c: [row["decibels"][str(v)][error] for row in chosen if row["capture"] == c] for c in captures}
                    for v in (default.value, value)
                )
                of_captures = [
                    f"{statistics.mean(candidate[c]) - statistics.mean(today[c]):+.2f} ({len(today[c])})"
                    for c in captures
                ]
                gain = gain_of(today, candidate)
                cells = [name, str(value), error, *of_captures, f"{gain.mean:+.2f} ± {gain.standard_error:.2f}"]
                lines.append(f"| {' | '.join(cells)} | {gain.verdict} |")
        lines.append("")
    return "\n".join([*lines, "The number of seeds stands in brackets."])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(NAMES))
    parser.add_argument("--materials", type=Path, help="folder of `python -m benchmarks.materials make`")
    parser.add_argument("--workspace", type=Path, help="finished runs are kept here")
    parser.add_argument("--half", choices=HALVES, default=HALVES[0])
    parser.add_argument("--only", nargs="*", default=(), help="names or numbers of captures")
    parser.add_argument("--seeds", default="0,1,2")
    parser.add_argument("--store", type=Path, default=STORE, help="file of stored lines")
    parser.add_argument("--table", type=Path, metavar="FILE", help="print the table of stored lines, measure nothing")
    options = parser.parse_args()
    if options.table is not None:
        print(table(stored_rows(options.table)))
        return
    if options.materials is None or options.workspace is None:
        parser.error("name --materials and --workspace, or --table")
    for name in options.names:
        if name not in NAMES:
            parser.error(f"{name} is not one of {', '.join(NAMES)}")
    if bool(options.names) == (options.half == "validation"):
        parser.error("name constants for the tuning half, none for the validation half")
    plugins = PluginManager.discover()
    values = {n: (DEFAULT_VALUES[n].value, *DEFAULT_VALUES[n].candidates) for n in options.names}
    values = values or {NAMES[0]: (DEFAULT_VALUES[NAMES[0]].value,)}
    known = {(row["capture"], row["seed"], row["constant"]) for row in stored_rows(options.store)}
    for seed in parse_seeds(options.seeds):
        for capture in find_captures(options.materials, (options.half,), tuple(options.only)).captures:
            missing = [name for name in values if (capture.name, seed, name) not in known]
            with shared_fits():
                found = [measured(name, values[name], capture, seed, options.workspace, plugins) for name in missing]
            add_rows(options.store, found)


if __name__ == "__main__":
    main()
