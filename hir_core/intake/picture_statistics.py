"""Sharpness of photographs, and duplicates among them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from hir_exporters.conventions import linear_to_srgb

from hir_core.capture import Pixels

_ROWS_AT_ONCE = 1024


def sharpness(pixels: Pixels) -> float:
    """Ratio of fine to coarse differences of brightness inside the mask; independent of contrast, 0 if unknown."""
    image = linear_to_srgb(np.clip(pixels.color_linear.mean(axis=2), 0, 1))
    inner = np.ones_like(image, dtype=bool) if pixels.mask is None else pixels.mask > 0.99
    if min(image.shape) < 8 or inner.sum() < 64:
        return 0.0

    def detail(step: int) -> float:
        change = (image[:-step, :-step] - image[step:, step:]) ** 2
        both = inner[:-step, :-step] & inner[step:, step:]
        return float(change[both].mean()) if both.any() else 0.0

    return detail(1) / max(detail(4), 1e-12)


def find_duplicates(pixels: Sequence[Pixels]) -> list[tuple[int, int]]:
    """Photographs that equal an earlier one except for noise, each with the first such one before it: (first, it)."""
    prints = []
    for picture in pixels:
        image = linear_to_srgb(np.clip(picture.color_linear.mean(axis=2), 0, 1))
        rows = np.linspace(0, image.shape[0] - 1, 24).astype(int)
        columns = np.linspace(0, image.shape[1] - 1, 24).astype(int)
        prints.append(image[np.ix_(rows, columns)].reshape(-1))
    if len(prints) < 2:
        return []
    table = np.array(prints)
    squares = (table**2).mean(axis=1)
    found: list[tuple[int, int]] = []
    for start in range(0, len(table), _ROWS_AT_ONCE):  # the whole matrix of 10,000 photographs would take gigabytes
        part = slice(start, start + _ROWS_AT_ONCE)
        gap = squares[part, None] + squares[None, :] - 2 * table[part] @ table.T / table.shape[1]
        equal = np.tril(gap < 2e-5, start - 1)  # all pairs of 10,000 equal photographs would be 50 million
        found += [(int(equal[row].argmax()), int(row) + start) for row in np.flatnonzero(equal.any(axis=1))]
    return found
