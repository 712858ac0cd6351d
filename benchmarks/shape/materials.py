"""Four materials of the shape benchmark, as parameters of Mitsuba's `principled` BSDF at each vertex."""

from __future__ import annotations

from typing import Final

import numpy as np

from benchmarks.materials.materials import METALS, Array, Surface, color, waves

MATERIALS: Final = ("textured", "plain", "glossy", "metal")


def draw_surface(material: str, points: Array, rng: np.random.Generator) -> Surface:
    """The surface at points (V, 3). `textured` has detail of 5 to 20 pixels at 256², `plain` none; `glossy` is a coarse
    pattern under a sharp highlight, `metal` a reflection alone.
    """
    count = len(points)
    if material == "metal":
        name = str(rng.choice(sorted(METALS)))
        return Surface(np.tile(METALS[name], (count, 1)), np.ones(count), np.full(count, 0.3), {"specular": 0.5})
    if material == "plain":
        return Surface(np.tile(color(rng, 0.2), (count, 1)), np.zeros(count), np.full(count, 0.8), {"specular": 0.3})
    scale = 1.0 if material == "glossy" else 3.0
    blend, dots = waves(points, rng, scale)[:, None], waves(points, rng, 2 * scale)[:, None]
    base = color(rng, 0.15) * blend + color(rng, 0.05, 0.4) * (1 - blend)
    base = np.where(dots > 0.6, 0.3 * base, base)
    roughness = 0.25 if material == "glossy" else 0.8
    return Surface(base, np.zeros(count), np.full(count, roughness), {"specular": 0.5})
