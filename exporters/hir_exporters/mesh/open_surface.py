"""Whether a surface has borders."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.mesh.vertex_welding import weld

_SAME_POSITION: Final = 1e-4
_SHORT_BORDER: Final = 0.05


def is_open(positions: NDArray[np.float32], faces: NDArray[np.integer]) -> bool:
    """Whether edges with an odd number of triangles are longer, together, than 5 % of the diagonal of the bounding box.

    Vertices in one cell of a grid of 1/10,000 of the diagonal are one vertex: the two sides of a seam differ by
    rounding. This cannot open a surface that is closed.
    """
    low = positions.min(axis=0)
    diagonal = float(np.linalg.norm(positions.max(axis=0) - low))
    if diagonal == 0:
        return False
    first, group = weld(np.round((positions - low) / (_SAME_POSITION * diagonal)).astype(np.float32))
    corners = group[faces]
    begin, end = corners.ravel(), corners[:, [1, 2, 0]].ravel()
    sides = begin != end  # a triangle with two corners at one position has no side between them
    keys = np.minimum(begin, end)[sides] * len(positions) + np.maximum(begin, end)[sides]
    edges, count = np.unique(keys, return_counts=True)
    one, other = np.divmod(edges[count % 2 == 1], len(positions))
    lengths = np.linalg.norm(positions[first[one]] - positions[first[other]], axis=-1)
    return float(lengths.sum()) > _SHORT_BORDER * diagonal
