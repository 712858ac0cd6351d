"""Adds to the errors of maps what all photographs have in common: a wrong light, a wrong width of the lobe.

Their spread between photographs does not show it. How large it is was measured on captures whose material is known
(docs/studies/map_errors.md), as a share of the map's value and a floor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from hir_core.scene import Material
from hir_core.scene.map_errors import OUTSIDE, MapErrors
from hir_core.stages.reflectance.error_estimate.pixel_derivatives import (
    BASE_COLOR,
    METALNESS,
    ROUGHNESS,
    SPECULAR,
    map_values,
)

Array = NDArray[np.float32]


@dataclass(frozen=True)
class CommonError:
    """error² = (variation_factor · variation)² + (share · value)² + floor²."""

    variation_factor: float
    share: float
    floor: float

    def error(self, variation: NDArray[np.floating], value: NDArray[np.floating], widest: float) -> NDArray[np.float64]:
        """The whole standard error, at most `widest`, which is that of a map of which nothing is known."""
        found = np.sqrt((self.variation_factor * variation) ** 2 + (self.share * value) ** 2 + self.floor**2)
        return np.asarray(np.minimum(found, widest))


COMMON_ERRORS: Final = {
    BASE_COLOR: CommonError(1.07, 0.081, 0.003),
    METALNESS: CommonError(1.0, 0.0, 0.02),
    ROUGHNESS: CommonError(1.0, 0.096, 0.084),
    SPECULAR: CommonError(1.0, 0.0, 0.018),
}
"""`python -m benchmarks.map_error_calibration --fit` on runs of captures of the tuning half: 0.68 of the true errors
lie below the estimate. The spread of metalness and ρs counts in full: it tells
the few places where metalness is wrong, and blocks that no photograph determines stay as uncertain as before."""


def with_common_errors(errors: MapErrors, material: Material, widest: dict[str, float]) -> MapErrors:
    """The errors of a fit whose light was fitted, too; `errors` is the spread between photographs alone, which the
    result keeps. `widest` has the error of each map where nothing is known.
    """
    variation: dict[str, Array] = {BASE_COLOR: errors.base_color} | errors.maps
    variation |= {name: np.full((1, 1), value, np.float32) for name, value in errors.constants.items()}

    def whole(name: str) -> Array:
        rows, columns = errors.condition.shape
        value = _means_of_blocks(map_values(material, name), rows, columns)
        value = value if name == BASE_COLOR else value.mean(axis=2)
        if name in errors.constants:
            value = value[:1, :1]
        return COMMON_ERRORS[name].error(variation[name], value, widest[name]).astype(np.float32)

    def as_map(name: str) -> Array:
        inside = errors.condition != OUTSIDE
        found = whole(name)
        return np.where(inside[..., None] if found.ndim == 3 else inside, found, np.float32(np.nan))

    return replace(
        errors,
        base_color=as_map(BASE_COLOR),
        maps={name: as_map(name) for name in errors.maps},
        constants={name: float(whole(name)[0, 0]) for name in errors.constants},
        variation=variation,
    )


def _means_of_blocks(values: torch.Tensor, rows: int, columns: int) -> Array:
    """Means (rows, columns, C) of a texture over blocks of texels; a constant everywhere."""
    if values.ndim == 1:
        return np.broadcast_to(values.detach().cpu().numpy(), (rows, columns, len(values)))
    planes = values.detach().permute(2, 0, 1)[None]
    means = torch.nn.functional.adaptive_avg_pool2d(planes, (rows, columns))
    return np.asarray(means[0].permute(1, 2, 0).cpu().numpy())
