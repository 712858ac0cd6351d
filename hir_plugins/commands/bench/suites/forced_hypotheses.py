"""Hypotheses that a run is forced to: a kind of material under a light in the world or on the camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

KIND_SETTINGS: Final = {
    "diffuse": "reflectance.model=diffuse",
    "dielectric": "reflectance.brdf=dielectric",
}
"""Kind of material → the setting that forces it."""

LIGHT_FRAMES: Final = ("world", "camera")


@dataclass(frozen=True)
class Hypothesis:
    """A kind of material and a light frame."""

    kind: str
    light_frame: str

    @property
    def name(self) -> str:
        """As tables print it."""
        return f"forced: {self.kind}, light {'in the world' if self.light_frame == 'world' else 'on the camera'}"

    @property
    def assignments(self) -> tuple[str, ...]:
        """The settings that leave only this hypothesis; maps and indirect light are still selected where the kind
        allows them."""
        return KIND_SETTINGS[self.kind], f"reflectance.light_frame={self.light_frame}"


HYPOTHESES: Final = tuple(Hypothesis(kind, frame) for frame in LIGHT_FRAMES for kind in KIND_SETTINGS)
