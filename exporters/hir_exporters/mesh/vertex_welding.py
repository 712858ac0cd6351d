"""Welding: finds vertices with equal attributes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def weld(rows: NDArray[np.float32]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Groups equal rows of (V, C): `first` (P,) is the lowest index of each distinct row, `group` (V,) its number.

    `rows[first][group]` equals `rows`. Groups are numbered in the order of their first row. -0 and 0 are equal.
    """
    keys = np.ascontiguousarray(rows + np.float32(0)).view(np.uint32)
    order = np.lexsort(keys.T[::-1])
    ordered = keys[order]
    new_row = np.ones(len(rows), dtype=bool)
    new_row[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    # lexsort is stable: the first row of each block has the lowest index.
    first = order[new_row]
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    group = np.empty(len(rows), dtype=np.int64)
    group[order] = rank[np.cumsum(new_row) - 1]
    return np.sort(first), group
