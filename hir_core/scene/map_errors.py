"""How certain the maps of a material are: standard errors of blocks of texels, and why blocks are uncertain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from numpy.typing import NDArray

OUTSIDE, OBSERVED, UNDER_OBSERVED, IN_SHADOW, UNDER_HIGHLIGHTS = range(5)
"""Conditions of a block: without surface; seen well; by too few photographs; only in shadow; only under highlights."""


@dataclass(frozen=True, eq=False)
class MapErrors:
    """Standard errors over blocks of texels, row 0 at the top of the texture; NaN where there is no surface."""

    base_color: Float[NDArray[np.float32], "H W 3"]
    """Linear, of the base colour or the diffuse albedo."""
    maps: dict[str, NDArray[np.float32]]
    """`specular`, `metalness`, `roughness` (√α): (H, W) of each that varies over the surface."""
    constants: dict[str, float]
    """The same of each that is one value for the whole surface."""
    condition: UInt8[NDArray[np.uint8], "H W"]
    """`OUTSIDE`, `OBSERVED`, `UNDER_OBSERVED` (by too few photographs), `IN_SHADOW` or `UNDER_HIGHLIGHTS` in all."""
    variation: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
    """By map, `base_color` included: the part of the errors in which photographs differ; a constant has the shape
    (1, 1). Empty where the errors are that part alone.
    """

    def report(self) -> dict[str, Any]:
        """For run.json: medians and 95th percentiles over the surface, and shares of the conditions."""
        surface = self.condition != OUTSIDE
        values = {"base_color": self.base_color.mean(axis=2)} | self.maps
        of_maps = {
            name: {
                "median": _rounded(np.median(each[surface])),
                "largest_5_percent": _rounded(np.quantile(each[surface], 0.95)),
            }
            for name, each in values.items()
        }
        constants = {name: {"constant": _rounded(value)} for name, value in self.constants.items()}
        names = {"under_observed": UNDER_OBSERVED, "in_shadow": IN_SHADOW, "under_highlights": UNDER_HIGHLIGHTS}
        shares = {name: _rounded((self.condition[surface] == code).mean()) for name, code in names.items()}
        return {"standard_errors": of_maps | constants, "shares": shares, "blocks": [*self.condition.shape]}


def _rounded(value: Any) -> float:
    return float(f"{float(value):.4g}")
