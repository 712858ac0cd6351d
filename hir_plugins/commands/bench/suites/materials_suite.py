"""Choice of material and light on made captures with known truth: what was chosen, errors, and regret."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from hir_core.errors import ConfigError
from hir_plugins.commands.bench.bench_options import BenchOptions
from hir_plugins.commands.bench.inputs.materials_captures import MaterialsCapture, find_captures
from hir_plugins.commands.bench.materials_options import MaterialsOptions
from hir_plugins.commands.bench.results.bench_result import Case, Row
from hir_plugins.commands.bench.results.materials_summary import NOT_RENDERED, REGRET, SELECTED, UNSEEN, WITHIN_NOISE
from hir_plugins.commands.bench.suites.forced_hypotheses import hypotheses
from hir_plugins.commands.bench.suites.materials_run import RunFigures, current_key, run_figures


def materials_rows(options: BenchOptions) -> Iterator[Row]:
    """One row for each capture and seed; with `regret`, one for each forced hypothesis before it."""
    chosen = options.materials
    if chosen is None:
        raise ConfigError("hir bench materials needs the rendered captures; name their folder with --materials DIR")
    found = find_captures(chosen.folder, chosen.halves, chosen.only)
    for capture in found.captures[:1] if options.quick else found.captures:
        for seed in chosen.seeds:
            yield from capture_rows(capture, seed, chosen, options)
    for name, half in found.missing.items():
        case: Case = {"half": half, "capture": name, "mesh": chosen.mesh, "seed": chosen.seeds[0]}
        yield Row(case, SELECTED, "ours", None, note=NOT_RENDERED)


def capture_rows(
    capture: MaterialsCapture, seed: int, chosen: MaterialsOptions, options: BenchOptions
) -> Iterator[Row]:
    """The rows of one capture and seed."""
    case: Case = {"half": capture.half, "capture": capture.name, "mesh": chosen.mesh, "seed": seed}

    def figures(settings: tuple[str, ...] = ()) -> RunFigures:
        return run_figures(
            current_key(capture, chosen.mesh, seed, (*chosen.settings, *settings)),
            capture,
            options.workspace,
            options.plugins,
        )

    forced: list[float] = []
    for hypothesis in hypotheses() if chosen.regret else ():
        result = figures(hypothesis.assignments)
        forced.append(result.errors[UNSEEN])
        yield Row(case, hypothesis.name, "ours", result.timing, result.errors, labels=labels(capture, result))
    selected = figures()
    errors = dict(selected.errors)
    if forced:
        errors[REGRET] = regret_db(selected.errors[UNSEEN], forced)
    yield Row(case, SELECTED, "ours", selected.timing, errors, labels=labels(capture, selected))


def regret_db(selected: float, forced: Sequence[float]) -> float:
    """dB that the selection loses against the best forced hypothesis; negative where it is better than all of them."""
    return max(forced) - selected


def labels(capture: MaterialsCapture, found: RunFigures) -> dict[str, str]:
    """What was found beside what is true."""
    noise = {None: "", True: WITHIN_NOISE, False: "clear"}[found.margin_within_noise]
    return {
        "light": found.light_frame,
        "true light": capture.light_frame,
        "kind": found.kind,
        "true kind": capture.kind if capture.within_model else f"{capture.kind}, outside the model",
        "margin": noise,
        "model": found.model,
    }
