"""Curves of a stage's scalars as inline SVG."""

from __future__ import annotations

import html

import numpy as np
from numpy.typing import NDArray

WIDTH, HEIGHT, LEFT, BOTTOM, TOP = 420, 170, 54, 22, 26
MAX_POINTS = 400


def curve_svg(title: str, steps: NDArray[np.generic], values: NDArray[np.generic]) -> str:
    """One curve with its first, least and last value marked; logarithmic where it spans more than two decades."""
    x, y = thinned(np.asarray(steps, np.float64), np.asarray(values, np.float64))
    if len(x) < 2:
        return ""
    logarithmic = bool(y.min() > 0 and y.max() / y.min() > 100)
    heights = np.log10(y) if logarithmic else y
    low, high = float(heights.min()), float(heights.max())
    span = high - low or 1.0
    across = LEFT + (x - x[0]) / max(x[-1] - x[0], 1e-12) * (WIDTH - LEFT - 12)
    down = HEIGHT - BOTTOM - (heights - low) / span * (HEIGHT - BOTTOM - TOP)
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(across, down, strict=True))
    scale = " (log)" if logarithmic else ""
    label = html.escape(f"{title}{scale}")
    return (
        f'<svg class=curve viewBox="0 0 {WIDTH} {HEIGHT}" role=img aria-label="{label}">'
        f"<text x={LEFT} y=15 class=name>{label}</text><text x={WIDTH - 12} y=15 class=last>{y[-1]:.4g}</text>"
        f"<text x={LEFT - 6} y={TOP + 4} class=axis>{y.max():.3g}</text>"
        f"<text x={LEFT - 6} y={HEIGHT - BOTTOM} class=axis>{y.min():.3g}</text>"
        f"<text x={LEFT} y={HEIGHT - 6} class=step>{x[0]:.0f}</text>"
        f"<text x={WIDTH - 12} y={HEIGHT - 6} class=last>step {x[-1]:.0f}</text>"
        f"<path class=grid d='M{LEFT} {TOP}H{WIDTH - 12}M{LEFT} {HEIGHT - BOTTOM}H{WIDTH - 12}'/>"
        f'<polyline points="{points}"/></svg>'
    )


def thinned(steps: NDArray[np.float64], values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """At most `MAX_POINTS` of the finite values: means of equal blocks."""
    finite = np.isfinite(steps) & np.isfinite(values)
    steps, values = steps[finite], values[finite]
    if len(values) <= MAX_POINTS:
        return steps, values
    blocks = np.array_split(np.arange(len(values)), MAX_POINTS)
    return np.array([steps[b].mean() for b in blocks]), np.array([values[b].mean() for b in blocks])
