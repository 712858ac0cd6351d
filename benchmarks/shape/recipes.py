"""Which captures the benchmark has: object, material and light of each, and the half that it belongs to."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.shape.materials import MATERIALS
from benchmarks.shape.shapes import OBJECTS, Half, Kind

SEED = 20261122
LIGHTS = ("overcast", "softboxes", "windows", "sun", "lamps")
"""Of the materials benchmark; all of them stand still in the world."""


@dataclass(frozen=True)
class Recipe:
    """One capture; everything random in it follows from `seed`."""

    name: str
    object: str
    kind: Kind
    material: str
    light: str
    half: Half
    seed: int


def recipes() -> list[Recipe]:
    """All captures, the same at every call: each object in each material, the lights in turn."""
    found = []
    for i, (name, made) in enumerate(OBJECTS.items()):
        for j, material in enumerate(MATERIALS):
            light = LIGHTS[(i + 2 * j) % len(LIGHTS)]
            found.append(Recipe(f"{name}_{material}", name, made.kind, material, light, made.half, SEED + 10 * i + j))
    return found
