"""Decides again the constants that were once chosen by unseen views of three captures (docs/studies/default_values.md).

`python -m benchmarks.default_values list`, or
`python -m benchmarks.default_values run NAME… --materials DIR --workspace DIR [--only CAPTURE…] [--seeds 0,1,2]`: each
candidate value on captures of the tuning half, beside today's value, with several seeds. An interrupted study resumes.
Results are stored in benchmarks/results/default_values, with commit, date and machine.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from typing import Any

from hir_core.files.json_documents import write_json
from hir_core.plugins.manager import PluginManager
from hir_core.run.machine import describe_machine, source_commit
from hir_plugins.commands.bench.inputs.materials_captures import MaterialsCapture, find_captures
from hir_plugins.commands.bench.materials_options import MeshSource, parse_seeds
from hir_plugins.commands.bench.results.materials_summary import RELIT, UNSEEN
from hir_plugins.commands.bench.suites.materials_run import current_key, run_figures

RESULTS = Path(__file__).resolve().parent / "results" / "default_values"
MEASURES = (UNSEEN, RELIT)
REQUIRED_STANDARD_ERRORS = 2.0
"""Of the mean gain over captures; a smaller difference is not called one."""


@dataclass(frozen=True)
class DefaultValue:
    """A constant or a setting, and the values that it is compared with."""

    value: float | int | str
    """Today's."""
    candidates: tuple[float | int | str, ...]
    setting: str = ""
    constants: tuple[str, ...] = ()
    """`module:NAME`, where it is defined and where it was imported to."""
    mesh: MeshSource = "truth"
    """`reconstructed` for what acts before the material is fitted."""


SELECTION = "hir_core.stages.reflectance.model_selection"
PHOTOGRAPHS = "hir_core.stages.geometry.photo_refinement"
TEXTURES = "hir_plugins.reflectance_renderers.transport_ggx.textures"
DEFAULT_VALUES = {
    "required_standard_errors": DefaultValue(1.0, (0.5, 2.0), constants=(f"{SELECTION}:REQUIRED_STANDARD_ERRORS",)),
    "standard_errors_of_normals": DefaultValue(
        2.0, (1.0, 3.0), constants=(f"{SELECTION}:REQUIRED_STANDARD_ERRORS_OF_NORMALS",)
    ),
    "photo_significance": DefaultValue(
        1.0, (0.5, 2.0), constants=(f"{PHOTOGRAPHS}:SIGNIFICANCE",), mesh="reconstructed"
    ),
    "least_fine_gain": DefaultValue(
        0.03, (0.01, 0.1), constants=(f"{PHOTOGRAPHS}:LEAST_FINE_GAIN",), mesh="reconstructed"
    ),
    "texel_prior_weight": DefaultValue(
        0.01,
        (0.003, 0.05),
        constants=tuple(
            f"{TEXTURES}.{module}:TEXEL_PRIOR_WEIGHT"
            for module in ("texture_solve", "per_texel_maps", "albedo_refinement")
        ),
    ),
    "light_whiteness": DefaultValue(1e-3, (0.0, 1e-2), "reflectance_renderer.transport_ggx.light_whiteness"),
    "texture_size": DefaultValue(0, (128, 512), "atlas.texture_size"),
    "stereo": DefaultValue(
        '["visual_hull"]', ('["visual_hull", "stereo"]',), setting="initializers", mesh="reconstructed"
    ),
}


@dataclass(frozen=True)
class Gain:
    """Of a candidate over today's value, in dB."""

    mean: float
    standard_error: float
    """Over captures; infinite for one."""
    seeds_deviation: float | None
    """Root mean square over captures of the standard deviation over seeds; None for one seed."""

    @property
    def verdict(self) -> str:
        """`better`, `worse` or `no difference`."""
        if abs(self.mean) <= REQUIRED_STANDARD_ERRORS * self.standard_error:
            return "no difference"
        return "better" if self.mean > 0 else "worse"


def gain_of(today: Mapping[str, Sequence[float]], candidate: Mapping[str, Sequence[float]]) -> Gain:
    """The mean gain over captures, each the mean over seeds, which both share; by name of the capture."""
    differences = {name: [new - old for old, new in zip(today[name], candidate[name], strict=True)] for name in today}
    means = [statistics.mean(found) for found in differences.values()]
    error = statistics.stdev(means) / len(means) ** 0.5 if len(means) > 1 else float("inf")
    variances = [statistics.variance(found) for found in differences.values() if len(found) > 1]
    return Gain(statistics.mean(means), error, statistics.mean(variances) ** 0.5 if variances else None)


@contextmanager
def changed(default: DefaultValue, value: float | int | str) -> Iterator[None]:
    """The constants with another value, in every module that has them."""
    before = []
    for constant in default.constants:
        module_name, _, name = constant.partition(":")
        module = import_module(module_name)
        before.append((module, name, getattr(module, name)))
        setattr(module, name, value)
    try:
        yield
    finally:
        for module, name, old in before:
            setattr(module, name, old)


def measure(
    name: str, value: float | int | str, capture: MaterialsCapture, seed: int, workspace: Path, plugins: PluginManager
) -> dict[str, float]:
    """Unseen and relit dB of one capture with one value."""
    default = DEFAULT_VALUES[name]
    is_today = value == default.value
    settings = () if is_today or not default.setting else (f"{default.setting}={value}",)
    variant = "" if is_today or default.setting else f"{name}-{value}"
    key = replace(current_key(capture, default.mesh, seed, settings), variant=variant)
    with changed(default, value):
        figures = run_figures(key, capture, workspace, plugins)
    return {error: figures.errors[error] for error in MEASURES}


def study(
    name: str, captures: Sequence[MaterialsCapture], seeds: Sequence[int], workspace: Path, plugins: PluginManager
) -> dict[str, Any]:
    """The result of one constant: figures of every run, and gains with their verdict."""
    default = DEFAULT_VALUES[name]
    found: dict[str, dict[str, dict[str, list[float]]]] = {}
    for value in (default.value, *default.candidates):
        of_value = found.setdefault(str(value), {error: {} for error in MEASURES})
        for capture in captures:
            for seed in seeds:
                for error, decibels in measure(name, value, capture, seed, workspace, plugins).items():
                    of_value[error].setdefault(capture.name, []).append(decibels)
                print(f"{name} = {value}: {capture.name}, seed {seed}", flush=True)
    today = found[str(default.value)]
    gains = {}
    for value in default.candidates:
        of_candidate = {error: gain_of(today[error], found[str(value)][error]) for error in MEASURES}
        gains[str(value)] = {error: asdict(gain) | {"verdict": gain.verdict} for error, gain in of_candidate.items()}
    return {
        "name": name,
        "default": asdict(default),
        "seeds": list(seeds),
        "runs": found,
        "gains": gains,
        "commit": source_commit(),
        "date": datetime.now(UTC).date().isoformat(),
        "machine": describe_machine("cpu"),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("list", help="print constants, today's values and candidates")
    run = commands.add_parser("run", help="measure candidates on the tuning half")
    run.add_argument("names", nargs="+", choices=list(DEFAULT_VALUES), metavar="NAME")
    run.add_argument("--materials", type=Path, required=True, help="folder of `python -m benchmarks.materials make`")
    run.add_argument("--workspace", type=Path, required=True, help="finished runs are kept here")
    run.add_argument("--only", nargs="*", default=(), help="names or numbers of captures")
    run.add_argument("--seeds", default="0,1,2")
    options = parser.parse_args()
    if options.command == "list":
        for name, default in DEFAULT_VALUES.items():
            print(f"{name}: {default.value}; candidates {', '.join(map(str, default.candidates))}; mesh {default.mesh}")
        return
    plugins = PluginManager.discover()
    captures = find_captures(options.materials, ("tuning",), options.only).captures
    for name in options.names:
        result = study(name, captures, parse_seeds(options.seeds), options.workspace, plugins)
        write_json(RESULTS / f"{name}.json", result)
        print(result["gains"])


if __name__ == "__main__":
    main()
