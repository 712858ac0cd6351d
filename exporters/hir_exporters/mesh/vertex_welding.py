"""Which vertices of an asset's mesh are one point of the surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def weld(rows: NDArray[np.float32]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Equal rows (V, C) as one: `first` (P,), the lowest index of each distinct row, and `group` (V,) into it.

    `rows[first][group]` equals `rows`. Groups are numbered in the order of their first row. -0 and 0 are equal.
    """
    keys = np.ascontiguousarray(rows + np.float32(0)).view(np.uint32)
    order = np.lexsort(keys.T[::-1])
    ordered = keys[order]
    starts = np.ones(len(rows), dtype=bool)
    starts[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    # lexsort is stable: the first of each block has the lowest index.
    heads = order[starts]
    rank = np.empty(len(heads), dtype=np.int64)
    rank[np.argsort(heads)] = np.arange(len(heads))
    group = np.empty(len(rows), dtype=np.int64)
    group[order] = rank[np.cumsum(starts) - 1]
    return np.sort(heads), group
