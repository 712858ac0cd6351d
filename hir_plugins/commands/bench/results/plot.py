"""Results as an SVG plot: time against size and against error, one line per method; equal rows give equal bytes."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

from hir_plugins.commands.bench.results.bench_result import Result, Row, error_names, group_by_case_names

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLORS: Final = ("#b4552d", "#2f6f8f", "#3f8f5f", "#8a5fa8", "#b08a1e", "#6b6d74", "#c2567a", "#4b6bd6")
MARKERS: Final = "os^Dv"


def plot_svg(result: Result) -> str:
    """Two panels for each kind of case: seconds by case, and seconds against the first error.

    Bars show the range of the repetitions. The plot is empty if no row has a timing.
    """
    import matplotlib
    from matplotlib.figure import Figure

    groups = group_by_case_names([row for row in result.rows if row.timing is not None])
    if not groups:
        return ""
    figure = Figure(figsize=(12, 4.2 * len(groups)), layout="constrained")
    for rows, (by_case, by_error) in zip(groups, figure.subplots(len(groups), 2, squeeze=False), strict=True):
        _draw_panels(rows, by_case, by_error)
    figure.suptitle(f"hir bench {result.suite}", fontsize=10)
    stream = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": "hir", "svg.fonttype": "none"}):
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return stream.getvalue()


def _draw_panels(rows: Sequence[Row], by_case: Axes, by_error: Axes) -> None:
    errors = error_names(rows)
    methods = list(dict.fromkeys(row.method for row in rows))
    cases = list(dict.fromkeys(tuple(row.case.items()) for row in rows))
    for i, method in enumerate(methods):
        method_rows = [row for row in rows if row.method == method]
        style: dict[str, Any] = {
            "color": COLORS[i % len(COLORS)],
            "marker": MARKERS[i // len(COLORS) % len(MARKERS)],
            "ms": 4,
            "ls": "--" if method_rows[0].role != "ours" else "-",
            "lw": 1.2,
        }
        _draw_line(by_case, method_rows, [cases.index(tuple(row.case.items())) for row in method_rows], style, method)
        if errors:
            with_error = [row for row in method_rows if row.errors.get(errors[0]) is not None]
            # a line connects budgets of the same task only
            line = {} if len({_task(row) for row in method_rows}) == 1 else {"ls": "none"}
            _draw_line(by_error, with_error, [row.errors[errors[0]] for row in with_error], style | line, method)
    by_case.set(yscale="log", ylabel="seconds", xticks=range(len(cases)))
    by_case.set_xticklabels([" ".join(str(v) for _, v in case) for case in cases], rotation=60, ha="right", fontsize=6)
    by_error.set(yscale="log", ylabel="seconds", xlabel=errors[0] if errors else "")
    if errors and "dB" not in errors[0] and all(row.errors.get(errors[0], 1) > 0 for row in rows):
        by_error.set(xscale="log")
    for axes in (by_case, by_error):
        axes.grid(True, color="#e2e0da", lw=0.5)
        axes.spines[["top", "right"]].set_visible(False)
    # outside the panels, where it cannot cover the lines
    handles, labels = by_case.get_legend_handles_labels()
    by_error.legend(handles, labels, fontsize=6, frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))


def _task(row: Row) -> tuple[tuple[str, object], ...]:
    return tuple((name, value) for name, value in row.case.items() if name != "budget")


def _draw_line(axes: Axes, rows: Sequence[Row], x: Sequence[float], style: dict[str, Any], label: str) -> None:
    timings = [row.timing for row in rows if row.timing is not None]
    if not timings:
        return
    median = [timing.median for timing in timings]
    ranges = [
        [timing.median - timing.minimum for timing in timings],
        [timing.maximum - timing.median for timing in timings],
    ]
    axes.errorbar(x, median, ranges, label=label, capsize=2, elinewidth=0.8, **style)
