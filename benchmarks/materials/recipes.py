"""Which captures the benchmark has: shape, material, lights and exposure of each, and the half that it belongs to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from benchmarks.materials.lights import LIGHTS
from benchmarks.materials.materials import MATERIALS
from benchmarks.materials.shapes import SHAPES

CAPTURES = 56
SEED = 20261122


@dataclass(frozen=True)
class Recipe:
    """One capture; everything random in it follows from `seed`."""

    name: str
    shape: str
    material: str
    light: str
    relights: tuple[str, str]
    exposure: float
    """Linear value that the brightest 2 % of object pixels reach; above 1 they are clipped."""
    half: Literal["tuning", "validation"]
    seed: int


def recipes() -> list[Recipe]:
    """All captures, the same at every call. Materials and shapes are spread evenly over both halves."""
    rng = np.random.default_rng(SEED)
    materials, shapes, lights = list(MATERIALS), list(SHAPES), list(LIGHTS)
    world = [name for name in lights if LIGHTS[name].frame == "world"]
    # lights that the camera carries are fewer than those that stand in the world, as among users' captures
    drawn = [*world, *world, *lights]
    found: list[Recipe] = []
    orders = {name: [] for name in ("shape", "light")}
    for i in range(CAPTURES):
        if not orders["shape"]:
            orders["shape"] = list(rng.permutation(shapes))
        if not orders["light"]:
            orders["light"] = list(rng.permutation(drawn))
        material = materials[i % len(materials)]
        shape, light = str(orders["shape"].pop()), str(orders["light"].pop())
        first, second = (str(name) for name in rng.choice([name for name in world if name != light], 2, replace=False))
        exposure = float(rng.choice([0.7, 0.8, 0.9, 1.4], p=[0.25, 0.35, 0.2, 0.2]))
        half: Literal["tuning", "validation"] = "tuning" if (i // len(materials)) % 2 == 0 else "validation"
        name = f"{i:02d}_{shape}_{material}_{light}"
        found.append(Recipe(name, shape, material, light, (first, second), exposure, half, SEED + i))
    return found
