"""A scalar field sampled on a grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Array


@dataclass(frozen=True)
class Volume:
    """A signed-distance field, sampled at the centres of cubic voxels."""

    values: NDArray[np.float32]
    """(X, Y, Z), in the unit of `spacing`, positive inside."""
    origin: Array
    """(3,), centre of the first voxel."""
    spacing: float
    """Side of a voxel in world units."""
