"""Hypotheses that a run is forced to: a kind of material under a light in the world or on the camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, get_args, get_type_hints

from hir_core.config import ReflectanceSettings

LIGHT_FRAMES: Final = ("world", "camera")


@dataclass(frozen=True)
class Hypothesis:
    """A kind of material and a light frame."""

    kind: str
    light_frame: str
    forcing: tuple[str, ...]
    """The settings that leave only this kind; maps and indirect light are still selected where it allows them."""

    @property
    def name(self) -> str:
        """As tables print it."""
        return f"forced: {self.kind}, light {'in the world' if self.light_frame == 'world' else 'on the camera'}"

    @property
    def assignments(self) -> tuple[str, ...]:
        """The settings of a run."""
        return *self.forcing, f"reflectance.light_frame={self.light_frame}"


def forcing_settings(choices: frozenset[str]) -> dict[str, tuple[str, ...]]:
    """Kind of material → the settings that force it, of those kinds that `reflectance.brdf` can express."""
    found: dict[str, tuple[str, ...]] = {}
    found["diffuse"] = ("reflectance.brdf=diffuse" if "diffuse" in choices else "reflectance.model=diffuse",)
    for kind, metalness in (("dielectric", ""), ("metal", "metal"), ("mixed", "map")):
        if kind in choices:
            found[kind] = (f"reflectance.brdf={kind}",)
        elif metalness and "metallic" in choices:
            found[kind] = ("reflectance.brdf=metallic", f"reflectance.metalness={metalness}")
    return found


def hypotheses() -> tuple[Hypothesis, ...]:
    """Every kind that the settings can force, under each light frame."""
    kinds = forcing_settings(frozenset(get_args(get_type_hints(ReflectanceSettings)["brdf"])))
    return tuple(Hypothesis(kind, frame, settings) for frame in LIGHT_FRAMES for kind, settings in kinds.items())
