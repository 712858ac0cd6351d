"""Results as a picture: seconds against error, one line a method, in SVG that is the same for the same rows."""

from __future__ import annotations

import io
from collections.abc import Sequence

from hir_plugins.commands.bench.results.bench_result import Result, Row, error_names, kinds

COLORS = ("#b4552d", "#2f6f8f", "#3f8f5f", "#8a5fa8", "#b08a1e", "#6b6d74", "#c2567a", "#4b6bd6")


def plot_svg(result: Result) -> str:
    """Two panels for each kind of case: seconds as cases grow, and against its first error; bars are repeats' range."""
    import matplotlib
    from matplotlib.figure import Figure

    found = kinds([row for row in result.rows if row.timing is not None])
    if not found:
        return ""
    figure = Figure(figsize=(12, 4.2 * len(found)), layout="constrained")
    for rows, axes in zip(found, figure.subplots(len(found), 2, squeeze=False), strict=True):
        _panels(rows, *axes)
    figure.suptitle(f"hir bench {result.suite}", fontsize=10)
    stream = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": "hir", "svg.fonttype": "none"}):
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return stream.getvalue()


def _panels(rows: Sequence[Row], growth, exchange) -> None:  # type: ignore[no-untyped-def]
    errors = error_names(rows)
    methods = list(dict.fromkeys(row.method for row in rows))
    cases = list(dict.fromkeys(tuple(row.case.items()) for row in rows))
    for i, method in enumerate(methods):
        own = [row for row in rows if row.method == method]
        style = {
            "color": COLORS[i % len(COLORS)],
            "marker": "os^Dv"[i // len(COLORS) % 5],
            "ms": 4,
            "ls": "--" if own[0].role != "ours" else "-",
            "lw": 1.2,
        }
        _panel(growth, own, [cases.index(tuple(row.case.items())) for row in own], style, method)
        if errors:
            judged = [row for row in own if row.errors.get(errors[0]) is not None]
            # budgets of one task make a curve; other cases are other tasks
            curve = {} if len({_task(row) for row in own}) == 1 else {"ls": "none"}
            _panel(exchange, judged, [row.errors[errors[0]] for row in judged], style | curve, method)
    growth.set(yscale="log", ylabel="seconds", xticks=range(len(cases)))
    growth.set_xticklabels([" ".join(str(v) for _, v in case) for case in cases], rotation=60, ha="right", fontsize=6)
    exchange.set(yscale="log", ylabel="seconds", xlabel=errors[0] if errors else "")
    if errors and "dB" not in errors[0] and all(row.errors.get(errors[0], 1) > 0 for row in rows):
        exchange.set(xscale="log")
    for axes in (growth, exchange):
        axes.grid(True, color="#e2e0da", lw=0.5)
        axes.spines[["top", "right"]].set_visible(False)
    # beside the panels: inside, it would lie on the curves
    names = growth.get_legend_handles_labels()
    exchange.legend(*names, fontsize=6, frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))


def _task(row: Row) -> tuple[tuple[str, object], ...]:
    return tuple((name, value) for name, value in row.case.items() if name != "budget")


def _panel(axes, rows: Sequence[Row], places: Sequence[float], style: dict[str, object], label: str) -> None:  # type: ignore[no-untyped-def]
    if not rows:
        return
    timings = [row.timing for row in rows if row.timing is not None]
    middle = [t.median for t in timings]
    spread = [[t.median - t.minimum for t in timings], [t.maximum - t.median for t in timings]]
    axes.errorbar(places, middle, spread, label=label, capsize=2, elinewidth=0.8, **style)
