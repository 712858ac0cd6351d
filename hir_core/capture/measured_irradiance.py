"""Irradiance that a card of known reflectance beside the object shows in the photographs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Color = tuple[float, float, float]


@dataclass(frozen=True)
class MeasuredIrradiance:
    """What arrives at a flat card, π × colour / reflectance, in the photographs that show it.

    It fixes the scale between albedo and light, and the light's colour, which the object alone does not show.
    """

    normal: Color
    """Unit normal of the card in the world, on its printed side."""
    values: Mapping[str, Color]
    """Irradiance of each channel by name of the view, in the unit of the photographs' linear values."""

    def __post_init__(self) -> None:
        """`ValueError` unless the normal has length 1 and all values are positive and finite."""
        if not math.isclose(math.hypot(*self.normal), 1, abs_tol=1e-6):
            raise ValueError("the normal of a card has length 1")
        known = [each for value in self.values.values() for each in value]
        if not known or any(len(value) != 3 for value in self.values.values()):
            raise ValueError("a card has three values of irradiance in each view, and at least one view")
        if not all(math.isfinite(each) and each > 0 for each in known):
            raise ValueError("irradiances of a card are positive and finite")

    @property
    def mean(self) -> Color:
        """Geometric mean over the views."""
        red, green, blue = np.exp(np.log(self._table).mean(axis=0)).tolist()
        return red, green, blue

    @property
    def relative_deviation(self) -> float:
        """Standard deviation over the views, as a fraction: exposures that differ, shadows, gloss."""
        return float(np.log(self._table).std(axis=0).max())

    def rotated(self, rotation: NDArray[np.floating]) -> MeasuredIrradiance:
        """In a world that is turned by `rotation`, 3×3."""
        x, y, z = (rotation @ np.array(self.normal)).tolist()
        length = math.hypot(x, y, z)
        return MeasuredIrradiance((x / length, y / length, z / length), self.values)

    def as_document(self) -> dict[str, Any]:
        """For JSON."""
        return {"normal": list(self.normal), "values": {name: list(value) for name, value in self.values.items()}}

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> MeasuredIrradiance:
        """The inverse of `as_document`; `KeyError`, `TypeError` or `ValueError` where it is malformed."""
        x, y, z = (float(each) for each in document["normal"])
        named = {}
        for name, value in dict(document["values"]).items():
            red, green, blue = (float(each) for each in value)
            named[str(name)] = (red, green, blue)
        return cls((x, y, z), named)

    @property
    def _table(self) -> Array:
        """(views, 3)."""
        return np.array(list(self.values.values()), dtype=np.float64)
