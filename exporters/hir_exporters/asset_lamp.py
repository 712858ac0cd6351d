"""A lamp that the cameras of the photographs carried, such as a flash. numpy only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hir_exporters.errors import InputError


@dataclass(frozen=True, eq=False)
class AssetLamp:
    """A lamp in the axes of each photograph's camera.

    At a distance r, and at an angle t from the viewing axis, the irradiance of a point of it on a surface that faces it
    is `intensity cos(t)^exponent / r^2`. No format has such a light: files describe it (`described_provenance`).
    """

    intensity: NDArray[np.float64]
    """(3,), linear, not negative: radiance times the square of the asset's unit of length."""
    offset: NDArray[np.float64]
    """(3,): place in the camera's axes (x to the right, y down, z forwards), in the asset's unit of length."""
    exponent: float = 0.0
    radius: float = 0.0
    """Of a disc across the viewing axis, in the asset's unit of length; 0 for a point. The irradiance is the mean over
    its points."""

    def __post_init__(self) -> None:
        for name in ("intensity", "offset"):
            try:
                value = np.ascontiguousarray(getattr(self, name), np.float64)
            except (TypeError, ValueError) as error:
                raise InputError(f"environment.lamp.{name} is not an array of numbers ({error})") from error
            object.__setattr__(self, name, value)

    def scaled(self, factor: float) -> AssetLamp:
        """The lamp where all lengths are `factor` times as large: the object is as bright as before."""
        return AssetLamp(self.intensity * factor**2, self.offset * factor, self.exponent, self.radius * factor)


def validate_lamp(lamp: AssetLamp) -> None:
    """Raises `InputError` for the first invalid field."""
    for name in ("intensity", "offset"):
        value = getattr(lamp, name)
        if value.shape != (3,):
            raise InputError(f"environment.lamp.{name} has the shape {value.shape}; it must be (3,)")
        if not np.isfinite(value).all():
            raise InputError(f"environment.lamp.{name} is {value.tolist()}; it must be three finite numbers")
    if lamp.intensity.min() < 0:
        raise InputError("environment.lamp.intensity has negative values; clip them to 0")
    for name in ("exponent", "radius"):
        size = getattr(lamp, name)
        if not isinstance(size, int | float) or not 0 <= size < float("inf"):
            raise InputError(f"environment.lamp.{name} is {size!r}; it must be one finite number, 0 or more")


def lamp_description(lamp: AssetLamp) -> dict[str, Any]:
    """The lamp as JSON values, as files and scenes hold it."""
    return {
        "intensity": lamp.intensity.tolist(),
        "offset": lamp.offset.tolist(),
        "exponent": float(lamp.exponent),
        "radius": float(lamp.radius),
    }


def described_provenance(provenance: Mapping[str, Any], lamp: AssetLamp | None) -> dict[str, Any]:
    """An asset's provenance as exported files hold it: with its lamp, if there is one, as `camera_lamp`."""
    return {**provenance, **({} if lamp is None else {"camera_lamp": lamp_description(lamp)})}
