"""Estimated standard errors of maps against their true errors.

    python -m benchmarks.map_error_calibration RUN… [--store FILE]
    python -m benchmarks.map_error_calibration RUN… --fit
    python -m benchmarks.map_error_calibration --table FILE

RUN is a finished run of a capture of the materials benchmark, whose material is known at every pixel of its test views.
The base colour is scaled by one factor for each channel first, because the scale between albedo and light is assumed
and not in the estimate. A ratio is a true error over its estimated standard error: 0.68 of normal errors lie below 1
and 0.95 below 2. One line is stored for each run and map, with commit, date and machine.

`--fit` prints the constants of `COMMON_ERRORS` for runs of captures of the tuning half: the quantile 0.68 of the true
errors as a function of the spread between photographs and of the map's value, by the pinball loss, each run with the
same weight.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from hir_exporters.conventions import srgb_to_linear
from hir_exporters.textures.image_files import read_ldr
from numpy.typing import NDArray

from benchmarks.stored_rows import add_rows, parsed, provenance
from hir_core.errors import InputError
from hir_core.metrics import OBJECT_COVERAGE, ChannelScale, unassociate
from hir_core.plugins.manager import PluginManager
from hir_core.rendering.unlit_renderer import UnlitRenderer
from hir_core.run.finished_run import FinishedRun, open_finished_run
from hir_core.run.run_directory import RunDirectory
from hir_core.scene.map_error_store import load_map_errors
from hir_core.scene.map_errors import OBSERVED
from hir_core.stages.reflectance.error_estimate.common_errors import CommonError, with_common_errors
from hir_core.stages.reflectance.error_estimate.error_estimate import PRIOR_WIDTHS
from hir_core.stages.reflectance.error_estimate.pixel_derivatives import map_values
from hir_plugins.commands.bench.inputs.parameter_errors import scene_showing

STORE = Path("benchmarks/results/map_error_calibration.jsonl")
PICTURES = {"base_color": "base_color", "metalness": "metallic", "roughness": "roughness"}
"""Names of maps and of their true pictures. ρs has none: `principled` has one F0 for the whole surface."""
WHOLLY = 0.999
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MapPixels:
    """A map at the object's pixels of the test views, in blocks whose condition is `OBSERVED`; (N, C)."""

    fit: Array
    true: Array
    variation: Array
    """The estimated standard error from photographs that differ."""
    error: Array
    """The whole one."""

    def scaled(self) -> MapPixels:
        """With one factor for each channel that brings the fit nearest to the truth."""
        scale = ChannelScale()
        scale.add(self.fit.astype(np.float32), self.true.astype(np.float32))
        factor = scale.value.astype(np.float64)
        return MapPixels(self.fit * factor, self.true, self.variation * factor, self.error * factor)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="*", type=Path)
    parser.add_argument("--store", type=Path, default=STORE, help="file of stored lines")
    parser.add_argument("--fit", action="store_true", help="print the constants for these runs, store nothing")
    parser.add_argument("--table", type=Path, metavar="FILE", help="print the table of stored lines, measure nothing")
    options = parsed(parser, table)
    if not options.runs:
        parser.error("name finished runs, or --table")
    plugins = PluginManager.discover()
    try:
        runs = [open_finished_run(RunDirectory(path)) for path in options.runs]
        if options.fit:
            print_constants([known_pixels(run, plugins) for run in runs])
            return
        for run in runs:
            add_rows(options.store, measured(run, plugins))
    except InputError as error:
        parser.error(str(error))


def print_constants(of_runs: Sequence[dict[str, MapPixels]]) -> None:
    """A line for each map."""
    for name in sorted({name for each in of_runs for name in each}):
        print(name, fitted_constants([each[name] for each in of_runs if name in each]))


def measured(run: FinishedRun, plugins: PluginManager) -> list[dict[str, Any]]:
    """One line for each map that has an estimate and a truth."""
    shared = {
        "capture": run.capture_path.name,
        "half": _truth(run)["half"],
        "run": run.directory.path.name,
        "model": run.document["stages"]["reflectance"]["report"]["model"],
        **provenance(),
    }
    return [
        shared
        | {"map": name, "variation_alone": figures(each.fit - each.true, each.variation)}
        | figures(each.fit - each.true, each.error)
        for name, each in known_pixels(run, plugins).items()
    ]


def _truth(run: FinishedRun) -> dict[str, Any]:
    path = run.capture_path / "truth.json"
    if not path.is_file():
        raise InputError(f"{run.directory.path}: its capture has no {path}; give runs of the materials benchmark")
    document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return document


def known_pixels(run: FinishedRun, plugins: PluginManager) -> dict[str, MapPixels]:
    """The maps that have both an estimated error and a known truth."""
    errors, material, truth = load_map_errors(run.directory.stage("reflectance")), run.scene.material, _truth(run)
    if errors is None or material is None:
        raise InputError(f"{run.directory.path} has no map errors; run it with: --set reflectance.map_errors=true")
    if not errors.variation:  # of a run whose errors are the spread alone
        errors = with_common_errors(errors, material, PRIOR_WIDTHS)
    whole: dict[str, Array] = {"base_color": errors.base_color} | errors.maps
    whole |= {name: np.full((1, 1), value) for name, value in errors.constants.items()}
    true_f0 = 0.08 * float(truth["constants"]["specular"]) if truth["kind"] == "dielectric" else None
    names = [name for name in whole if name in PICTURES or (name == "specular" and true_f0 is not None)]
    shown = {(name, "fit"): map_values(material, name) for name in names}
    shown |= {(name, "error"): _texture(whole[name]) for name in names}
    shown |= {(name, "variation"): _texture(errors.variation.get(name, whole[name])) for name in names}
    shown["", "observed"] = _texture((errors.condition == OBSERVED).astype(np.float32))
    renderers = {key: UnlitRenderer(scene_showing(values, run.scene)) for key, values in shown.items()}
    capture = run.read_split(run.capture_path, "test", plugins)
    parts: dict[str, list[tuple[Array, ...]]] = {name: [] for name in names}
    for view, camera in zip(capture.views, capture.cameras, strict=True):
        values = {key: unassociate(renderer.render(camera)) for key, renderer in renderers.items()}
        observed = values["", "observed"][0][..., 0] > WHOLLY  # a lookup at the border of a chart is a mixture
        for name in names:
            picture = read_ldr(
                run.capture_path / "truth_test" / f"{Path(view.name).stem}_{PICTURES.get(name, 'base_color')}.png"
            )
            fit, coverage = values[name, "fit"]
            inside = observed & (picture[..., 3] > OBJECT_COVERAGE) & (coverage > OBJECT_COVERAGE)
            true = picture[..., :3][inside].astype(np.float64)
            if name == "base_color":
                true = srgb_to_linear(true)
            elif name == "specular":
                true = np.full_like(true, true_f0)
            estimates = (values[name, which][0][inside] for which in ("variation", "error"))
            parts[name].append((fit[inside], true, *estimates))
    found = {}
    for name, pieces in parts.items():
        pixels = MapPixels(*(np.concatenate([piece[i] for piece in pieces]).astype(np.float64) for i in range(4)))
        if name == "base_color":
            found[name] = pixels.scaled()
        else:
            found[name] = MapPixels(*(getattr(pixels, field.name)[:, :1] for field in fields(MapPixels)))
    return found


def _texture(values: Array) -> torch.Tensor:
    """(H, W) or (H, W, 3) with 0 where there is no surface; one value for (1, 1)."""
    if values.shape == (1, 1):
        return torch.from_numpy(values.reshape(1).astype(np.float32))
    planes = values if values.ndim == 3 else values[..., None]
    return torch.from_numpy(np.nan_to_num(planes).astype(np.float32))


def fitted_constants(runs: Sequence[MapPixels], level: float = 0.68) -> CommonError:
    """The error below which a share `level` of the true ones lies, as a function of spread and value."""
    from scipy.optimize import minimize

    parts = [
        np.stack([np.abs(each.fit - each.true).ravel(), each.variation.ravel(), each.fit.ravel()]) for each in runs
    ]

    def loss(logarithms: Array) -> float:
        constants = CommonError(*(float(each) for each in np.exp(logarithms)))
        losses = []
        for true, variation, value in parts:
            above = true - constants.error(variation, value, np.inf)
            losses.append(float(np.maximum(level * above, (level - 1) * above).mean()))
        return float(np.mean(losses))

    guesses = [np.log([factor, share, 0.01]) for factor in (1.0, 4.0) for share in (0.02, 0.2)]
    options = {"xatol": 1e-3, "fatol": 1e-8, "maxiter": 2000}
    fits = [minimize(loss, guess, method="Nelder-Mead", options=options) for guess in guesses]
    found = min(fits, key=lambda fit: fit.fun)
    return CommonError(*(round(float(each), 4) for each in np.exp(found.x)))


def figures(error: Array, estimate: Array) -> dict[str, Any]:
    """How well an estimate tells the errors: shares within one and two of it, the median ratio in units of that of
    normal errors (1 is calibrated), and the rank correlation (None for a constant).
    """
    from scipy.stats import spearmanr

    size, estimate = np.abs(error).ravel(), estimate.ravel()
    ratio = size / np.maximum(estimate, 1e-9)
    constant = float(np.ptp(estimate)) < 1e-4 * float(estimate.max())
    return {
        "pixels": len(size),
        "median_error": round(float(np.median(size)), 4),
        "median_estimate": round(float(np.median(estimate)), 4),
        "within_1": round(float((ratio < 1).mean()), 4),
        "within_2": round(float((ratio < 2).mean()), 4),
        "median_ratio": round(float(np.median(ratio)) / 0.6745, 3),
        "rank_correlation": None if constant else round(float(spearmanr(estimate, size).statistic), 3),
    }


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown, a line for each run and map; figures of the spread alone, then of the whole estimate."""
    lines = [
        "| map | half | capture | model | true error, median | estimate, median | within 1 (0.68) | within 2 (0.95) | "
        "rank correlation |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in sorted(rows, key=lambda each: (each["map"], each["half"], each["capture"], each["run"])):
        variation = row["variation_alone"]
        pairs = [
            f"{_text(variation[key], form)} → {_text(row[key], form)}"
            for key, form in (
                ("median_estimate", ".3f"),
                ("within_1", ".2f"),
                ("within_2", ".2f"),
                ("rank_correlation", ".2f"),
            )
        ]
        lines.append(
            f"| {row['map']} | {row['half']} | {row['capture']} | {row['model']} | {row['median_error']:.3f} | "
            + " | ".join(pairs)
            + " |"
        )
    for name in sorted({row["map"] for row in rows}):
        for half in ("tuning", "validation"):
            chosen = [row for row in rows if row["map"] == name and row["half"] == half]
            alone = [row["variation_alone"] for row in chosen]
            if len(chosen) > 1:
                means = [
                    " → ".join(f"{np.mean([each[key] for each in part]):.2f}" for part in (alone, chosen))
                    for key in ("within_1", "within_2")
                ]
                lines.append(f"| {name} | {half} | mean of {len(chosen)} | | | | {means[0]} | {means[1]} | |")
    return "\n".join(lines)


def _text(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)


if __name__ == "__main__":
    main()
