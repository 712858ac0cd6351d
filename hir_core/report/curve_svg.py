"""Curves of a stage's scalars as inline SVG."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from hir_core.report.page_templates import render

WIDTH, HEIGHT, LEFT, RIGHT, BOTTOM, TOP = 420, 170, 54, 12, 22, 26
"""Size and margins in SVG units."""
MAX_POINTS = 400
LOG_SCALE_RATIO = 100
"""Largest over smallest value above which the scale is logarithmic."""


def curve_svg(title: str, steps: NDArray[np.generic], values: NDArray[np.generic]) -> Markup:
    """One curve with its last, smallest and largest value; empty where there are fewer than two finite points."""
    x, y = block_means(np.asarray(steps, np.float64), np.asarray(values, np.float64))
    if len(x) < 2:
        return Markup("")
    logarithmic = bool(y.min() > 0 and y.max() / y.min() > LOG_SCALE_RATIO)
    heights = np.log10(y) if logarithmic else y
    low, high = float(heights.min()), float(heights.max())
    span = high - low or 1.0
    across = LEFT + (x - x[0]) / max(x[-1] - x[0], 1e-12) * (WIDTH - LEFT - RIGHT)
    down = HEIGHT - BOTTOM - (heights - low) / span * (HEIGHT - BOTTOM - TOP)
    return render(
        "curve.svg",
        width=WIDTH,
        height=HEIGHT,
        left=LEFT,
        right=WIDTH - RIGHT,
        top=TOP,
        bottom=HEIGHT - BOTTOM,
        label=f"{title}{' (log)' if logarithmic else ''}",
        last=f"{y[-1]:.4g}",
        highest=f"{y.max():.3g}",
        lowest=f"{y.min():.3g}",
        first_step=f"{x[0]:.0f}",
        last_step=f"{x[-1]:.0f}",
        points=" ".join(f"{a:.1f},{b:.1f}" for a, b in zip(across, down, strict=True)),
    )


def block_means(
    steps: NDArray[np.float64], values: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The finite values, as means of equal blocks where there are more than `MAX_POINTS`."""
    finite = np.isfinite(steps) & np.isfinite(values)
    steps, values = steps[finite], values[finite]
    if len(values) <= MAX_POINTS:
        return steps, values
    blocks = np.array_split(np.arange(len(values)), MAX_POINTS)
    return np.array([steps[b].mean() for b in blocks]), np.array([values[b].mean() for b in blocks])
