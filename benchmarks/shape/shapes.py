"""Objects of the shape benchmark as signed distances; each is made of parts from `benchmarks.materials.shapes`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from benchmarks.materials.shapes import (
    SHAPES,
    Array,
    Distance,
    capsule,
    difference,
    lathe,
    rounded_box,
    smooth_union,
    sphere,
    torus,
)

Half = Literal["tuning", "validation"]
Kind = Literal["convex", "concave", "holed", "thin"]


@dataclass(frozen=True)
class ObjectClass:
    """One object; `parts` makes its signed distances."""

    kind: Kind
    half: Half
    parts: Callable[[], list[Distance]]


def union(parts: list[Distance]) -> Distance:
    return lambda p: np.min([part(p) for part in parts], axis=0)


def _stone() -> list[Distance]:
    """A superellipsoid: flat sides and round edges, convex."""
    half = np.array([0.8, 0.6, 0.5])
    return [lambda p: 0.5 * ((np.abs(p / half) ** 3).sum(axis=1) ** (1 / 3) - 1)]


def _basket() -> list[Distance]:
    """Twelve bars and five rings above a solid bottom: 48 windows."""
    bars = []
    for angle in np.arange(12) * 2 * np.pi / 12:
        low = (0.5 * np.cos(angle), 0.5 * np.sin(angle), -0.5)
        high = (0.8 * np.cos(angle), 0.8 * np.sin(angle), 0.4)
        bars.append(capsule(low, high, 0.045))
    levels = np.linspace(-0.5, 0.4, 5)
    rings = [torus((0, 0, float(z)), 0.5 + 0.3 * (float(z) + 0.5) / 0.9, 0.05, 2) for z in levels]
    bottom = lathe(lambda r, z: np.maximum(r - 0.5, np.abs(z + 0.5) - 0.04))
    return [union(bars), union(rings), bottom]


def _gear(radius: float, teeth: int, center_z: float, half_height: float) -> Distance:
    def distance(p: Array) -> Array:
        angle = np.arctan2(p[:, 1], p[:, 0])
        edge = radius + 0.06 * np.tanh(3 * np.sin(teeth * angle))
        return 0.6 * np.maximum(np.hypot(p[:, 0], p[:, 1]) - edge, np.abs(p[:, 2] - center_z) - half_height)

    return distance


def _gears() -> list[Distance]:
    """A large gear with five round openings, and a small one on the same axle."""
    openings: list[Distance] = [
        lambda p, a=a: np.hypot(p[:, 0] - 0.5 * np.cos(a), p[:, 1] - 0.5 * np.sin(a)) - 0.16
        for a in np.arange(5) * 2 * np.pi / 5
    ]
    axle = capsule((0, 0, -0.35), (0, 0, 0.6), 0.12)
    return [difference(_gear(0.82, 18, -0.15, 0.1), union(openings)), _gear(0.32, 9, 0.3, 0.12), axle]


def _statue() -> list[Distance]:
    """A figure with its hands on its hips (two openings), rough on two scales."""
    body = smooth_union(capsule((0, 0, -0.5), (0, 0, 0.1), 0.26), sphere((0, 0, 0.55), 0.2), 0.12)
    arms: list[Distance] = []
    for side in (-1.0, 1.0):
        elbow = (0.52 * side, 0.05, -0.02)
        upper = capsule((0.2 * side, 0, 0.24), elbow, 0.075)
        arms.append(smooth_union(upper, capsule(elbow, (0.24 * side, 0.05, -0.32), 0.07), 0.02))
    smooth = smooth_union(body, union(arms), 0.03)

    def rough(p: Array) -> Array:
        coarse = np.sin(9 * p[:, 0] + 1) * np.sin(8 * p[:, 1] + 2) * np.sin(10 * p[:, 2])
        fine = np.sin(23 * p[:, 0]) * np.sin(21 * p[:, 1] + 1) * np.sin(25 * p[:, 2] + 2)
        return 0.8 * (smooth(p) - 0.03 * coarse - 0.012 * fine)

    return [rough, rounded_box((0, 0, -0.82), (0.4, 0.4, 0.09), 0.02)]


def _leaf() -> list[Distance]:
    """A curved sheet with seven lobes on a stem; 5 pixels thick at 256²."""

    def blade(p: Array) -> Array:
        radius, angle = np.hypot(p[:, 0], p[:, 1]), np.arctan2(p[:, 1], p[:, 0])
        edge = 0.62 + 0.2 * np.cos(7 * angle)
        height = 0.25 * radius**2 + 0.1 * radius * np.cos(3 * angle)
        return 0.45 * np.maximum(radius - edge, np.abs(p[:, 2] - height) - 0.022)

    return [blade, capsule((0, 0, 0), (0.1, 0.05, -0.6), 0.045)]


def _box() -> list[Distance]:
    """A box without a lid."""
    inside = rounded_box((0, 0, 0.12), (0.54, 0.39, 0.45), 0.02)
    return [difference(rounded_box((0, 0, 0), (0.6, 0.45, 0.4), 0.02), inside)]


def _stool() -> list[Distance]:
    """A seat on four legs with a ring between them: five openings below the seat."""
    seat = lathe(lambda r, z: np.maximum(r - 0.55, np.abs(z - 0.4) - 0.05) - 0.02)
    legs = []
    for angle in np.pi / 4 + np.arange(4) * np.pi / 2:
        x, y = float(np.cos(angle)), float(np.sin(angle))
        legs.append(capsule((0.38 * x, 0.38 * y, 0.4), (0.6 * x, 0.6 * y, -0.7), 0.06))
    return [seat, union(legs), torus((0, 0, -0.3), 0.52, 0.05, 2)]


def _bricks() -> list[Distance]:
    """Bricks with studs: an arch, a tower and a blade in front that stands free."""
    unit, gap = 0.17, 0.004
    bricks = [(-3, -1, 0, 6, 2, 1), (-3, -1, 1, 1, 2, 2), (2, -1, 1, 1, 2, 2), (-3, -1, 3, 6, 2, 1)]
    bricks += [(-1, -1, 4, 2, 2, 2), (-3, -3, 0, 1, 2, 1), (2, -3, 0, 1, 2, 1), (-3, -4, 0, 6, 1, 2)]
    solids, studs = [], []
    for x, y, z, width, depth, height in bricks:
        low = np.array([x, y, z]) * unit
        size = np.array([width, depth, height]) * unit
        middle, half = low + size / 2 - np.array([0, 0, 3 * unit]), size / 2 - gap + 0.006
        solids.append(rounded_box(tuple(middle), tuple(half), 0.012))
        for i in range(width):
            for j in range(depth):
                studs.append(_stud(low + np.array([i + 0.5, j + 0.5, height - 3]) * unit))
    return [union(solids), union(studs)]


def _stud(foot: Array) -> Distance:
    def distance(p: Array) -> Array:
        radius = np.hypot(p[:, 0] - foot[0], p[:, 1] - foot[1])
        return np.maximum(radius - 0.05, np.abs(p[:, 2] - foot[2]) - 0.04)

    return distance


OBJECTS: dict[str, ObjectClass] = {
    "stone": ObjectClass("convex", "tuning", _stone),
    "bowl": ObjectClass("concave", "tuning", SHAPES["bowl"]),
    "mug": ObjectClass("holed", "tuning", SHAPES["mug"]),
    "basket": ObjectClass("holed", "tuning", _basket),
    "gears": ObjectClass("holed", "tuning", _gears),
    "statue": ObjectClass("holed", "tuning", _statue),
    "leaf": ObjectClass("thin", "tuning", _leaf),
    "ball": ObjectClass("convex", "validation", SHAPES["bumpy_ball"]),
    "box": ObjectClass("concave", "validation", _box),
    "vase": ObjectClass("concave", "validation", SHAPES["vase"]),
    "knot": ObjectClass("holed", "validation", SHAPES["knot"]),
    "stool": ObjectClass("holed", "validation", _stool),
    "bricks": ObjectClass("holed", "validation", _bricks),
    "plate": ObjectClass("thin", "validation", SHAPES["plate"]),
}
"""An object belongs to one half with all its materials, so the validation half has no shape of the tuning half."""
