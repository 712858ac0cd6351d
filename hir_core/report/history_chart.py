"""PSNR against seconds as inline SVG, the stages as bands behind it."""

from __future__ import annotations

import html
from collections.abc import Iterator

import numpy as np

from hir_core.report.convergence import History, Series

WIDTH, HEIGHT = 1032, 360
LEFT, RIGHT, TOP, BOTTOM = 52, 16, 34, 58

LETTER, LEGEND_GAP = 6.0, 44.0
"""Width of a letter of the legend, and what a series' mark and margin take."""

LEAST_BAND = 34.0
"""A narrower stage is not labelled: its name would not fit."""


def history_chart(history: History) -> str:
    """The plot; a sentence where there is nothing to draw."""
    values = [v for series in history.series for v in series.psnr]
    if not values or not history.ends:
        return "<p class=quiet>No stage was measured.</p>"
    end = history.ends[-1][1] or 1.0
    low, high = np.floor(min(values) - 0.5), np.ceil(max(values) + 0.5)
    frame = _Frame(end, float(low), float(high))
    parts = [*_bands(history, frame), *_axes(frame)]
    place = float(LEFT)
    for series in history.series:
        parts += _line(series, frame)
        parts.append(_legend(series, place))
        place += LEGEND_GAP + LETTER * len(series.label)
    label = "PSNR over object pixels against seconds"
    return f'<svg class=history viewBox="0 0 {WIDTH} {HEIGHT}" role=img aria-label="{label}">{"".join(parts)}</svg>'


class _Frame:
    """From seconds and dB to the picture."""

    def __init__(self, end: float, low: float, high: float) -> None:
        self.end, self.low, self.high = end, low, high

    def x(self, seconds: float) -> float:
        return LEFT + seconds / self.end * (WIDTH - LEFT - RIGHT)

    def y(self, psnr: float) -> float:
        return HEIGHT - BOTTOM - (psnr - self.low) / (self.high - self.low) * (HEIGHT - BOTTOM - TOP)


def _bands(history: History, frame: _Frame) -> Iterator[str]:
    start = 0.0
    for i, (stage, end) in enumerate(history.ends):
        left, right = frame.x(start), frame.x(end)
        shade = "odd" if i % 2 else "even"
        yield (
            f'<rect class="band {shade}" x={left:.1f} y={TOP} width={max(right - left, 0):.1f} '
            f"height={HEIGHT - BOTTOM - TOP}><title>{stage}: {end - start:.1f} s</title></rect>"
        )
        if right - left > LEAST_BAND + 3 * len(stage):
            yield f"<text class=stage x={(left + right) / 2:.1f} y={TOP - 10}>{stage} · {end - start:.0f} s</text>"
        start = end


def _axes(frame: _Frame) -> Iterator[str]:
    for value in ticks(frame.low, frame.high, 6):
        y = frame.y(value)
        yield f"<path class=grid d='M{LEFT} {y:.1f}H{WIDTH - RIGHT}'/>"
        yield f"<text class=axis x={LEFT - 8} y={y + 4:.1f}>{value:g}</text>"
    for value in ticks(0, frame.end, 8):
        x = frame.x(value)
        yield f"<text class=second x={x:.1f} y={HEIGHT - BOTTOM + 18}>{value:g} s</text>"
    yield f"<text class=unit x={LEFT - 8} y={TOP - 10}>dB</text>"


def _line(series: Series, frame: _Frame) -> Iterator[str]:
    points = [(frame.x(s), frame.y(v)) for s, v in zip(series.seconds, series.psnr, strict=True)]
    kind = series.kind
    if len(points) > 1:
        yield f'<polyline class="line {kind}" points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in points)}"/>'
    for (x, y), second, value in zip(points, series.seconds, series.psnr, strict=True):
        title = f"<title>{html.escape(series.label)}: {value:.2f} dB at {second:.0f} s</title>"
        if kind == "unseen":
            yield f'<path class="mark {kind}" d="M{x:.1f} {y - 8:.1f}l7 8l-7 8l-7 -8z">{title}</path>'
        else:
            radius = 5 if kind == "stages" else 3.4
            yield f'<circle class="mark {kind}" cx={x:.1f} cy={y:.1f} r={radius}>{title}</circle>'


def _legend(series: Series, x: float) -> str:
    y = HEIGHT - 12
    return (
        f'<circle class="mark {series.kind}" cx={x + 6:.0f} cy={y - 4} r=4.5></circle>'
        f"<text class=legend x={x + 18:.0f} y={y}>{html.escape(series.label)}</text>"
    )


def ticks(low: float, high: float, wanted: int) -> list[float]:
    """Round numbers from `low` to `high`, about as many as wanted: steps of 1, 2 or 5 times a power of ten."""
    if not high > low:
        return [low]
    raw = (high - low) / wanted
    power = 10.0 ** np.floor(np.log10(raw))
    step = float(power * next(m for m in (1, 2, 5, 10) if m * power >= raw))
    first = np.ceil(low / step - 1e-9) * step
    return [float(round(v, 10)) + 0.0 for v in np.arange(first, high + step * 1e-6, step)]
