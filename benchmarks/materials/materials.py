"""Materials of the materials benchmark: parameters of Mitsuba's `principled` BSDF at each vertex.

None of them is one of `hir`'s own BRDFs; `sheen` and `clear_coat` are outside what `hir` can represent.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Kind = Literal["dielectric", "metal", "mixed"]


@dataclass(frozen=True, eq=False)
class Surface:
    """What a material is at V vertices; base colour is linear."""

    base_color: Array
    """V 3."""
    metallic: Array
    """V."""
    roughness: Array
    """V; the GGX width is its square."""
    constants: dict[str, float] = field(default_factory=dict)
    """Further parameters of `principled`: specular, clearcoat, clearcoat_gloss, sheen, sheen_tint."""


@dataclass(frozen=True)
class MaterialClass:
    """A family of materials; `draw` makes one of them."""

    kind: Kind
    draw: Callable[[Array, NDArray[np.int64], np.random.Generator], Surface]
    """Positions (V, 3), parts (V,), random numbers → surface."""
    within_model: bool = True
    """Can `hir` represent it?"""


def waves(points: Array, rng: np.random.Generator, scale: float) -> Array:
    """Smooth random values (V,) in 0…1, features of about 1/`scale` of the object's radius."""
    total = np.zeros(len(points))
    for _ in range(6):
        direction = rng.normal(size=3)
        direction *= scale * rng.uniform(1.5, 4.5) / np.linalg.norm(direction)
        total += np.sin(points @ direction + rng.uniform(0, 2 * np.pi))
    return 0.5 + 0.5 * np.tanh(total / 2)


def color(rng: np.random.Generator, low: float = 0.05, high: float = 0.8) -> Array:
    """A linear colour of random hue, saturation and brightness."""
    import colorsys

    encoded = colorsys.hsv_to_rgb(rng.uniform(), rng.uniform(0.3, 0.9), rng.uniform(0.45, 0.95))
    return np.clip(np.array(encoded) ** 2.2, low, high)


def _painted(points: Array, rng: np.random.Generator, scale: float = 1.5) -> Array:
    """Two or three colours with soft borders, V 3."""
    blend = waves(points, rng, scale)[:, None]
    base = color(rng) * blend + color(rng) * (1 - blend)
    spots = (waves(points, rng, 2.5) > 0.72)[:, None]
    return np.where(spots, color(rng), base)


def _dielectric(roughness: float, **constants: float) -> Callable[..., Surface]:
    def draw(points: Array, parts: NDArray[np.int64], rng: np.random.Generator) -> Surface:
        count = len(points)
        vary = roughness * (0.9 + 0.2 * waves(points, rng, 1.0))
        return Surface(_painted(points, rng), np.zeros(count), vary, {"specular": 0.5} | constants)

    return draw


METALS = {
    "gold": (1.0, 0.71, 0.29),
    "copper": (0.93, 0.5, 0.35),
    "silver": (0.95, 0.93, 0.88),
    "steel": (0.56, 0.57, 0.58),
}
"""Linear reflectance at normal incidence (common values of PBR charts)."""


def _metal(name: str, roughness: float) -> Callable[..., Surface]:
    def draw(points: Array, parts: NDArray[np.int64], rng: np.random.Generator) -> Surface:
        count = len(points)
        vary = roughness * (0.8 + 0.4 * waves(points, rng, 1.5))
        return Surface(np.tile(METALS[name], (count, 1)), np.ones(count), vary, {"specular": 0.5})

    return draw


def _metal_and_plastic(points: Array, parts: NDArray[np.int64], rng: np.random.Generator) -> Surface:
    """Part 0 is metal, the others are plastic; a shape of one part gets a band of plastic."""
    metal = parts == 0 if parts.max() > 0 else np.abs(points[:, 2] - 0.1) > 0.3
    name = rng.choice(list(METALS))
    plastic = color(rng)
    return Surface(
        np.where(metal[:, None], METALS[name], plastic),
        metal.astype(float),
        np.where(metal, rng.uniform(0.25, 0.45), rng.uniform(0.3, 0.6)),
        {"specular": 0.5},
    )


def _painted_metal(points: Array, parts: NDArray[np.int64], rng: np.random.Generator) -> Surface:
    """Paint in a pattern over bare metal."""
    bare = waves(points, rng, 1.3) > 0.5
    name = rng.choice(list(METALS))
    return Surface(
        np.where(bare[:, None], METALS[name], _painted(points, rng)),
        bare.astype(float),
        np.where(bare, rng.uniform(0.25, 0.4), rng.uniform(0.35, 0.6)),
        {"specular": 0.5},
    )


def _dark_rubber(points: Array, parts: NDArray[np.int64], rng: np.random.Generator) -> Surface:
    count = len(points)
    base = np.full((count, 3), rng.uniform(0.015, 0.04)) * (0.7 + 0.6 * waves(points, rng, 2.0))[:, None]
    return Surface(base, np.zeros(count), np.full(count, rng.uniform(0.5, 0.7)), {"specular": 0.5})


MATERIALS: dict[str, MaterialClass] = {
    "matt": MaterialClass("dielectric", _dielectric(0.95, specular=0.2)),
    "plastic_rough": MaterialClass("dielectric", _dielectric(0.6)),
    "plastic_satin": MaterialClass("dielectric", _dielectric(0.42)),
    "plastic_glossy": MaterialClass("dielectric", _dielectric(0.26)),
    "ceramic_glaze": MaterialClass("dielectric", _dielectric(0.18, specular=0.6)),
    "dark_rubber": MaterialClass("dielectric", _dark_rubber),
    "gold_polished": MaterialClass("metal", _metal("gold", 0.25)),
    "copper_brushed": MaterialClass("metal", _metal("copper", 0.45)),
    "silver_satin": MaterialClass("metal", _metal("silver", 0.35)),
    "steel_rough": MaterialClass("metal", _metal("steel", 0.6)),
    "metal_and_plastic": MaterialClass("mixed", _metal_and_plastic),
    "painted_metal": MaterialClass("mixed", _painted_metal),
    "sheen": MaterialClass("dielectric", _dielectric(0.8, sheen=1.0, sheen_tint=0.5), within_model=False),
    "clear_coat": MaterialClass(
        "dielectric", _dielectric(0.55, clearcoat=1.0, clearcoat_gloss=0.9), within_model=False
    ),
}
