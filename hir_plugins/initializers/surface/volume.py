"""A scalar field sampled on a grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Array


@dataclass(frozen=True)
class Volume:
    """Samples of a field at the centres of cubes; `origin` is the centre of the first one."""

    values: NDArray[np.float32]
    """X Y Z, in the unit of `spacing`, positive inside."""
    origin: Array
    spacing: float
