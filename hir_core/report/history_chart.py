"""PSNR against seconds as inline SVG, with the stages as bands behind it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from hir_core.report.convergence import History, Series
from hir_core.report.page_templates import render
from hir_core.report.tables import notice

WIDTH, HEIGHT = 1032, 360
LEFT, RIGHT, TOP, BOTTOM = 52, 16, 34, 58
"""Size and margins in SVG units."""

LETTER_WIDTH, LEGEND_GAP = 6.0, 44.0
"""Width of a letter in the legend, and of a mark with its margin."""

MIN_LABELLED_BAND = 34.0
"""Width of a band below which a stage is not labelled."""


@dataclass(frozen=True)
class _Axes:
    """From seconds and dB to SVG units."""

    end: float
    low: float
    high: float

    def x(self, seconds: float) -> float:
        return LEFT + seconds / self.end * (WIDTH - LEFT - RIGHT)

    def y(self, psnr: float) -> float:
        return HEIGHT - BOTTOM - (psnr - self.low) / (self.high - self.low) * (HEIGHT - BOTTOM - TOP)


def history_chart(history: History) -> Markup:
    """The chart; a sentence where nothing was measured."""
    values = [v for series in history.series for v in series.psnr]
    if not values or not history.ends:
        return notice("No stage was measured.")
    low, high = np.floor(min(values) - 0.5), np.ceil(max(values) + 0.5)
    axes = _Axes(history.ends[-1][1] or 1.0, float(low), float(high))
    lines, legend_x = [], float(LEFT)
    for series in history.series:
        lines.append(_line(series, axes) | {"legend_x": round(legend_x + 6)})
        legend_x += LEGEND_GAP + LETTER_WIDTH * len(series.label)
    return render(
        "history.svg",
        width=WIDTH,
        height=HEIGHT,
        left=LEFT,
        right=WIDTH - RIGHT,
        top=TOP,
        bottom=HEIGHT - BOTTOM,
        bands=_bands(history, axes),
        psnr_ticks=[
            {"at": f"{axes.y(v):.1f}", "text_at": f"{axes.y(v) + 4:.1f}", "text": f"{v:g}"}
            for v in ticks(axes.low, axes.high, 6)
        ],
        second_ticks=[{"at": f"{axes.x(v):.1f}", "text": f"{v:g} s"} for v in ticks(0, axes.end, 8)],
        lines=lines,
    )


def _bands(history: History, axes: _Axes) -> list[dict[str, str]]:
    bands, start = [], 0.0
    for stage, end in history.ends:
        left, right = axes.x(start), axes.x(end)
        is_wide = right - left > MIN_LABELLED_BAND + 3 * len(stage)
        bands.append(
            {
                "x": f"{left:.1f}",
                "width": f"{max(right - left, 0):.1f}",
                "middle": f"{(left + right) / 2:.1f}",
                "title": f"{stage}: {end - start:.1f} s",
                "label": f"{stage} · {end - start:.0f} s" if is_wide else "",
            }
        )
        start = end
    return bands


def _line(series: Series, axes: _Axes) -> dict[str, object]:
    points = [
        {
            "x": f"{axes.x(second):.1f}",
            "y": f"{axes.y(value):.1f}",
            "title": f"{series.label}: {value:.2f} dB at {second:.0f} s",
        }
        for second, value in zip(series.seconds, series.psnr, strict=True)
    ]
    return {"kind": series.kind, "label": series.label, "points": points}


def ticks(low: float, high: float, wanted: int) -> list[float]:
    """Round numbers from `low` to `high`, about `wanted` of them: steps of 1, 2 or 5 times a power of ten."""
    if not high > low:
        return [low]
    raw = (high - low) / wanted
    power = 10.0 ** np.floor(np.log10(raw))
    step = float(power * next(m for m in (1, 2, 5, 10) if m * power >= raw))
    first = np.ceil(low / step - 1e-9) * step
    return [float(round(v, 10)) + 0.0 for v in np.arange(first, high + step * 1e-6, step)]
