"""Constants of the texture solve and of the fitted light, on fits that are forced to the true kind of material.

`python -m benchmarks.forced_fits NAME… --materials DIR --workspace DIR [--only CAPTURE…] [--seeds 0,1,2]`, with some of
the names of `benchmarks.default_values`: each candidate beside today's value on captures of the tuning half, with true
mesh, kind and light frame. A model selection would cost ten times as much, and its decisions would hide what a constant
of the solver does. Runs are those of `hir reconstruct`; only values that act after the fit at vertices share that fit.
`--half validation` measures today's values alone. An interrupted study resumes. Results are stored in
benchmarks/results/default_values, with commit, date and machine.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any, get_args, get_type_hints

from benchmarks.default_values import DEFAULT_VALUES, MEASURES, RESULTS, Decibels, DefaultValue, Value, gain_of
from hir_core.config import ReflectanceSettings
from hir_core.errors import ConfigError
from hir_core.files.json_documents import write_json
from hir_core.plugins.interfaces import CheckpointLocation
from hir_core.plugins.manager import PluginManager
from hir_core.plugins.model_spec import ModelSpec
from hir_core.run.machine import describe_machine, source_commit
from hir_plugins.commands.bench.inputs.materials_captures import MaterialsCapture, find_captures
from hir_plugins.commands.bench.materials_options import HALVES, parse_seeds
from hir_plugins.commands.bench.suites.forced_hypotheses import forcing_settings
from hir_plugins.commands.bench.suites.materials_run import RunFigures, current_key, run_figures
from hir_plugins.reflectance_renderers.transport_ggx.solver import Fit, TransportSolver

NAMES = ("light_whiteness", "texel_prior_weight", "texture_size")
"""A setting of the fit, and values that act after it: a constant of the fit itself must not share fits."""
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


def summary(default: DefaultValue, runs: dict[Value, dict[str, Decibels]]) -> dict[str, Any]:
    """Figures of every run, and gains with their verdict, as benchmarks.default_values stores them."""
    gains: dict[str, dict[str, Any]] = {}
    for value in default.candidates:
        found = {error: gain_of(runs[default.value][error], runs[value][error]) for error in MEASURES}
        gains[str(value)] = {error: asdict(gain) | {"verdict": gain.verdict} for error, gain in found.items()}
    return {"runs": {str(value): found for value, found in runs.items()}, "gains": gains}


def origin(half: str, seeds: Sequence[int]) -> dict[str, Any]:
    """Where figures come from."""
    return {
        "half": half,
        "fit": "forced to the true kind and light frame, true mesh",
        "seeds": list(seeds),
        "commit": source_commit(),
        "date": datetime.now(UTC).date().isoformat(),
        "machine": describe_machine("cpu"),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(NAMES))
    parser.add_argument("--materials", type=Path, required=True, help="folder of `python -m benchmarks.materials make`")
    parser.add_argument("--workspace", type=Path, required=True, help="finished runs are kept here")
    parser.add_argument("--half", choices=HALVES, default=HALVES[0])
    parser.add_argument("--only", nargs="*", default=(), help="names or numbers of captures")
    parser.add_argument("--seeds", default="0,1,2")
    options = parser.parse_args()
    for name in options.names:
        if name not in NAMES:
            parser.error(f"{name} is not one of {', '.join(NAMES)}")
    if bool(options.names) == (options.half == "validation"):
        parser.error("name constants for the tuning half, none for the validation half")
    seeds, plugins = parse_seeds(options.seeds), PluginManager.discover()
    names = options.names
    captures = find_captures(options.materials, (options.half,), tuple(options.only)).captures
    values: dict[str, tuple[Value, ...]] = {n: (DEFAULT_VALUES[n].value, *DEFAULT_VALUES[n].candidates) for n in names}
    if not names:
        values = {NAMES[0]: (DEFAULT_VALUES[NAMES[0]].value,)}
    found: dict[str, dict[Value, dict[str, dict[str, list[float]]]]] = {
        name: {value: {error: {} for error in MEASURES} for value in values[name]} for name in values
    }
    for capture in captures:
        for seed in seeds:
            with shared_fits():
                for name, candidates in values.items():
                    for value in candidates:
                        figures = run_with(name, value, capture, seed, options.workspace, plugins)
                        for error in MEASURES:
                            found[name][value][error].setdefault(capture.name, []).append(figures.errors[error])
                        dB = ", ".join(f"{figures.errors[error]:.2f}" for error in MEASURES)
                        print(f"{capture.name} seed {seed} {name}={value}: {dB}", flush=True)
    # written last: a changed result would mark the code of the next run as changed
    about = origin(options.half, seeds)
    for name, runs in found.items():
        if not names:
            [today] = runs.values()
            write_json(RESULTS / f"today_{options.half}.json", {"runs": today, **about})
            continue
        default = DEFAULT_VALUES[name]
        write_json(
            RESULTS / f"{name}.json", {"name": name, "default": asdict(default), **summary(default, runs), **about}
        )


if __name__ == "__main__":
    main()
