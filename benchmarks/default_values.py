"""Decides again the constants that were once chosen by unseen views of three captures (docs/studies/default_values.md).

`python -m benchmarks.default_values list`, or
`python -m benchmarks.default_values run NAME… --materials DIR --workspace DIR [--only CAPTURE…] [--seeds 0,1,2]`: each
candidate value on captures of the tuning half, beside today's value, with several seeds. An interrupted study resumes.
Results are stored in benchmarks/results/default_values, with commit, date and machine.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from scipy.special import stdtrit

from benchmarks.stored_rows import provenance
from hir_core.files.json_documents import write_json
from hir_plugins.commands.bench.results.bench_result import Result
from hir_plugins.commands.bench.results.materials_summary import RELIT, SELECTED, UNSEEN

RESULTS = Path(__file__).resolve().parent / "results" / "default_values"
MEASURES = (UNSEEN, RELIT)
REQUIRED_STANDARD_ERRORS = 2.0
"""Of the mean gain over captures; a smaller difference is not called one."""
CONFIDENCE = 0.975
"""Of Student's t, one-sided: with few captures the standard error itself is uncertain, so more of them are required."""

Value = float | int | str
Decibels = Mapping[str, Sequence[float]]
"""By name of the capture, one for each seed."""


@dataclass(frozen=True)
class DefaultValue:
    """A constant or a setting, and the values that it is compared with."""

    value: Value
    """Today's."""
    candidates: tuple[Value, ...]
    setting: str = ""
    constant: str = ""
    """`package:NAME`, where it is no setting."""
    mesh: Literal["reconstructed", "truth"] = "truth"
    """`reconstructed` for what acts before the material is fitted."""
    fixed: tuple[str, ...] = ()
    """Settings of all runs, where the value acts in one model alone."""

    def command(self, value: Value) -> list[str]:
        """The Python command of `hir bench materials` with this value."""
        fixed = [argument for setting in self.fixed for argument in ("--set", setting)]
        if value == self.value:
            return ["hir_core.cli", "bench", "materials", *fixed]
        if self.setting:
            return ["hir_core.cli", "bench", "materials", *fixed, "--set", f"{self.setting}={value}"]
        return ["benchmarks.changed_constant", f"{self.constant}={value}", "bench", "materials", *fixed]


SELECTION = "hir_core.stages.reflectance.selection"
PHOTOGRAPHS = "hir_core.stages.geometry.photo_consistency"
FITS = "hir_plugins.reflectance_renderers.transport_ggx.fit"
TEXTURES = "hir_plugins.reflectance_renderers.transport_ggx.textures"
DEFAULT_VALUES = {
    "required_standard_errors": DefaultValue(1.0, (0.5, 2.0), constant=f"{SELECTION}:REQUIRED_STANDARD_ERRORS"),
    "standard_errors_of_hypotheses": DefaultValue(
        1.5, (1.0, 2.5), constant=f"{SELECTION}:REQUIRED_STANDARD_ERRORS_OF_HYPOTHESES"
    ),
    "drop_standard_errors": DefaultValue(2.0, (1.0, 3.0), constant=f"{SELECTION}:DROP_STANDARD_ERRORS"),
    "standard_errors_of_normals": DefaultValue(
        2.0, (1.0, 3.0), constant=f"{SELECTION}:REQUIRED_STANDARD_ERRORS_OF_NORMALS"
    ),
    "least_fine_gain": DefaultValue(0.03, (0.01, 0.1), constant=f"{PHOTOGRAPHS}:LEAST_FINE_GAIN", mesh="reconstructed"),
    "texel_prior_weight": DefaultValue(0.01, (0.003, 0.05), constant=f"{TEXTURES}:TEXEL_PRIOR_WEIGHT"),
    "texel_smoothness": DefaultValue(0.02, (0.1, 0.5), constant=f"{TEXTURES}:TEXEL_SMOOTHNESS_WEIGHT"),
    "light_whiteness": DefaultValue(1e-3, (0.0, 1e-2), "reflectance_renderer.transport_ggx.light_whiteness"),
    "light_smoothness": DefaultValue(1e-4, (1e-3, 1e-2), "reflectance_renderer.transport_ggx.light_smoothness"),
    "albedo_entropy": DefaultValue(3e-5, (0.0, 1e-4), "reflectance_renderer.transport_ggx.albedo_entropy"),
    "max_fitted_f0": DefaultValue(0.08, (0.05, 0.2), constant=f"{FITS}:MAX_FITTED_F0"),
    "metal_reflectance": DefaultValue(0.9, (0.6, 0.8), constant=f"{FITS}.initial:METAL_REFLECTANCE"),
    "initial_mean_albedo": DefaultValue(0.3, (0.15, 0.6), constant="hir_core.stages.reflectance:INITIAL_MEAN_ALBEDO"),
    "bilateral_specular": DefaultValue(
        0.0,
        (131.0,),  # the paper's, at 5,000 pixels a view (benchmarks/term_cost.py)
        "reflectance.regularizers.bilateral_specular.weight",
        fixed=("reflectance.brdf=dielectric", "reflectance.model=specular_map", "reflectance.light_frame=world"),
    ),
    "texture_size": DefaultValue(0, (128, 512), "atlas.texture_size"),
    "stereo": DefaultValue("auto", ('["visual_hull"]',), "initializers", mesh="reconstructed"),
}


@dataclass(frozen=True)
class Gain:
    """Of a candidate over today's value, in dB."""

    mean: float
    standard_error: float
    """Over captures; infinite for one."""
    seeds_deviation: float | None
    """Root mean square over captures of the standard deviation over seeds; None for one seed."""
    captures: int

    @property
    def required_standard_errors(self) -> float:
        """Two, or Student's t of the number of captures where that is more (3.2 for four, 2.6 for six)."""
        return max(REQUIRED_STANDARD_ERRORS, float(stdtrit(max(self.captures - 1, 1), CONFIDENCE)))

    @property
    def verdict(self) -> str:
        """`better`, `worse` or `no difference`."""
        if abs(self.mean) <= self.required_standard_errors * self.standard_error:
            return "no difference"
        return "better" if self.mean > 0 else "worse"


def gain_of(today: Decibels, candidate: Decibels) -> Gain:
    """The mean gain over captures, each the mean over seeds, which both share."""
    differences = {name: [new - old for old, new in zip(today[name], candidate[name], strict=True)] for name in today}
    means = [statistics.mean(found) for found in differences.values()]
    error = statistics.stdev(means) / len(means) ** 0.5 if len(means) > 1 else float("inf")
    variances = [statistics.variance(found) for found in differences.values() if len(found) > 1]
    deviation = statistics.mean(variances) ** 0.5 if variances else None
    return Gain(statistics.mean(means), error, deviation, len(means))


def measure(default: DefaultValue, value: Value, folder: Path, arguments: Sequence[str]) -> dict[str, Decibels]:
    """Unseen and relit dB with one value, by error, capture and seed; runs that `folder` holds are not repeated."""
    program = [sys.executable, "-m", *default.command(value), "--mesh", default.mesh, "--half", "tuning"]
    subprocess.run([*program, *arguments, "--workspace", str(folder), "-o", str(folder), "-q"], check=True)
    found: dict[str, dict[str, list[float]]] = {error: {} for error in MEASURES}
    for row in Result.read(folder / "materials.json").rows:
        if row.method == SELECTED and row.timing is not None:
            for error in MEASURES:
                found[error].setdefault(str(row.case["capture"]), []).append(row.errors[error])
    return dict(found)


def study(name: str, workspace: Path, arguments: Sequence[str]) -> dict[str, Any]:
    """The result of one constant: figures of every run, and gains with their verdict."""
    default = DEFAULT_VALUES[name]
    runs = {
        str(value): measure(default, value, workspace / name / f"candidate_{number}", arguments)
        for number, value in enumerate((default.value, *default.candidates))
    }
    today = runs[str(default.value)]
    gains: dict[str, dict[str, Any]] = {}
    for value in default.candidates:
        of_candidate = {error: gain_of(today[error], runs[str(value)][error]) for error in MEASURES}
        gains[str(value)] = {error: asdict(gain) | {"verdict": gain.verdict} for error, gain in of_candidate.items()}
    return {
        "name": name,
        "default": asdict(default),
        "arguments": [argument for argument in arguments if not Path(argument).is_absolute()],
        "runs": runs,
        "gains": gains,
        **provenance(),
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
    arguments = ["--seeds", options.seeds, "--materials", str(options.materials.resolve())]
    for capture in options.only:
        arguments += ["--only", capture]
    for name in options.names:
        result = study(name, options.workspace, arguments)
        write_json(RESULTS / f"{name}.json", result)
        print(result["gains"])


if __name__ == "__main__":
    main()
