"""Shapes of the materials benchmark: closed meshes from signed distances, with a part number for each vertex.

Every shape fits into the unit sphere and lies in the axes of the captures (+Z up).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Distance = Callable[[Array], Array]
"""Points (N, 3) → signed distances (N,), negative inside; a bound of the distance is enough."""

RESOLUTION = 176
"""Cells of the sampling grid along each axis."""


@dataclass(frozen=True, eq=False)
class Shape:
    """A triangle mesh."""

    positions: NDArray[np.float32]
    """V 3, in the unit sphere."""
    normals: NDArray[np.float32]
    """V 3, unit."""
    faces: NDArray[np.uint32]
    """F 3, counterclockwise seen from outside."""
    parts: NDArray[np.int64]
    """V: the number of the part that a vertex belongs to."""


def sphere(center: tuple[float, float, float], radius: float) -> Distance:
    return lambda p: np.linalg.norm(p - center, axis=1) - radius


def capsule(start: tuple[float, float, float], end: tuple[float, float, float], radius: float) -> Distance:
    a, b = np.array(start), np.array(end)

    def distance(p: Array) -> Array:
        along = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        return np.linalg.norm(p - a - along[:, None] * (b - a), axis=1) - radius

    return distance


def rounded_box(center: tuple[float, float, float], half: tuple[float, float, float], rounding: float) -> Distance:
    def distance(p: Array) -> Array:
        q = np.abs(p - center) - (np.array(half) - rounding)
        return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0) - rounding

    return distance


def lathe(profile: Callable[[Array, Array], Array]) -> Distance:
    """A solid of revolution around +Z; `profile` maps (radius, z) to distances."""
    return lambda p: profile(np.hypot(p[:, 0], p[:, 1]), p[:, 2])


def torus(center: tuple[float, float, float], ring: float, tube: float, axis: int) -> Distance:
    def distance(p: Array) -> Array:
        q = np.roll(p - center, 2 - axis, axis=1)
        return np.hypot(np.hypot(q[:, 0], q[:, 1]) - ring, q[:, 2]) - tube

    return distance


def tube_along(curve: Array, radius: float) -> Distance:
    """Around a closed or open polyline (K, 3)."""
    from scipy.spatial import cKDTree

    fine = np.concatenate([np.linspace(a, b, 8, endpoint=False) for a, b in itertools.pairwise(curve)])
    tree = cKDTree(fine)
    return lambda p: tree.query(p)[0] - radius


def smooth_union(first: Distance, second: Distance, blend: float) -> Distance:
    def distance(p: Array) -> Array:
        a, b = first(p), second(p)
        h = np.clip(0.5 + 0.5 * (b - a) / blend, 0, 1)
        return b * (1 - h) + a * h - blend * h * (1 - h)

    return distance


def difference(solid: Distance, removed: Distance) -> Distance:
    return lambda p: np.maximum(solid(p), -removed(p))


def _bumpy_ball() -> list[Distance]:
    def distance(p: Array) -> Array:
        bumps = 0.05 * np.sin(7 * p[:, 0] + 1) * np.sin(6 * p[:, 1] + 2) * np.sin(8 * p[:, 2])
        return np.linalg.norm(p, axis=1) - 0.85 - bumps

    return [distance]


def _bowl() -> list[Distance]:
    shell = difference(sphere((0, 0, 0.25), 0.85), sphere((0, 0, 0.32), 0.77))
    return [difference(shell, rounded_box((0, 0, 1.0), (2, 2, 0.75), 0.01)), lathe(_foot)]


def _foot(radius: Array, z: Array) -> Array:
    return np.maximum(np.abs(radius - 0.32) - 0.06, np.abs(z + 0.6) - 0.09) - 0.01


def _mug() -> list[Distance]:
    def body(radius: Array, z: Array) -> Array:
        outer = np.maximum(radius - 0.5, np.abs(z) - 0.65) - 0.02
        inner = np.maximum(radius - 0.43, -(z + 0.56))
        return np.maximum(outer, -inner)

    handle = difference(torus((0.52, 0, 0.02), 0.3, 0.075, 1), lathe(lambda r, z: np.maximum(r - 0.45, np.abs(z) - 2)))
    return [lathe(body), handle]


def _vase() -> list[Distance]:
    def profile(radius: Array, z: Array) -> Array:
        wall = 0.33 + 0.17 * np.sin(2.6 * z + 0.6) - 0.08 * z
        outer = np.maximum(0.75 * (radius - wall), np.abs(z) - 0.85)
        inner = np.maximum(0.75 * (radius - wall + 0.06), -(z + 0.76))
        return np.maximum(outer, -inner)

    return [lathe(profile)]


def _bottle() -> list[Distance]:
    def body(radius: Array, z: Array) -> Array:
        wall = np.where(z < 0.3, 0.36, 0.36 - 0.24 * np.clip((z - 0.3) / 0.25, 0, 1) ** 2)
        return np.maximum(0.7 * (radius - wall), np.maximum(-(z + 0.9), z - 0.66)) - 0.015

    cap = lathe(lambda r, z: np.maximum(r - 0.17, np.abs(z - 0.78) - 0.13) - 0.02)
    ring = lathe(lambda r, z: np.maximum(r - 0.385, np.abs(z + 0.55) - 0.11) - 0.01)
    return [lathe(body), cap, ring]


def _knot() -> list[Distance]:
    t = np.linspace(0, 2 * np.pi, 400)
    radius = 0.52 + 0.22 * np.cos(3 * t)
    curve = np.stack([radius * np.cos(2 * t), radius * np.sin(2 * t), 0.3 * np.sin(3 * t)], axis=1)
    return [tube_along(curve, 0.13)]


def _figure() -> list[Distance]:
    body = smooth_union(sphere((0, 0, -0.3), 0.46), sphere((0, 0, 0.35), 0.32), 0.12)
    arms = smooth_union(
        capsule((0.3, 0, -0.05), (0.62, 0.2, 0.3), 0.09), capsule((-0.3, 0, -0.05), (-0.6, 0.3, -0.2), 0.09), 0.02
    )
    base = lathe(lambda r, z: np.maximum(r - 0.6, np.abs(z + 0.82) - 0.07) - 0.02)
    return [smooth_union(body, arms, 0.08), base]


def _block() -> list[Distance]:
    solid = rounded_box((0, 0, -0.05), (0.55, 0.42, 0.36), 0.06)
    groove = rounded_box((0, 0.42, 0.0), (0.4, 0.12, 0.1), 0.04)
    hole = lambda p: np.hypot(p[:, 0] - 0.2, p[:, 2] + 0.02) - 0.14  # noqa: E731
    studs = [capsule((x, y, 0.28), (x, y, 0.4), 0.13) for x in (-0.28, 0.28) for y in (-0.2, 0.2)]
    return [difference(difference(solid, groove), hole), lambda p: np.min([stud(p) for stud in studs], axis=0)]


def _plate() -> list[Distance]:
    disc = lathe(lambda r, z: np.maximum(r - 0.85, np.abs(z - 0.12 * r**2) - 0.035) - 0.01)
    holes = [
        lambda p, a=a: np.hypot(p[:, 0] - 0.5 * np.cos(a), p[:, 1] - 0.5 * np.sin(a)) - 0.15
        for a in np.arange(5) * 2 * np.pi / 5
    ]
    return [difference(disc, lambda p: np.min([hole(p) for hole in holes], axis=0)), sphere((0, 0, 0.12), 0.2)]


def _spring() -> list[Distance]:
    t = np.linspace(0, 7 * np.pi, 500)
    curve = np.stack([0.45 * np.cos(t), 0.45 * np.sin(t), np.linspace(-0.7, 0.7, len(t))], axis=1)
    return [tube_along(curve, 0.11), capsule((0, 0, -0.75), (0, 0, 0.75), 0.2)]


SHAPES: dict[str, Callable[[], list[Distance]]] = {
    "bumpy_ball": _bumpy_ball,
    "bowl": _bowl,
    "mug": _mug,
    "vase": _vase,
    "bottle": _bottle,
    "knot": _knot,
    "figure": _figure,
    "block": _block,
    "plate": _plate,
    "spring": _spring,
}
"""Name → the parts of the shape. Smooth, bumpy, concave, thin, with holes, of several parts."""


def make_shape(name: str, resolution: int = RESOLUTION) -> Shape:
    """A shape of the table as one closed mesh, scaled to radius 0.95."""
    return mesh_of_parts(SHAPES[name](), resolution)


def mesh_of_parts(parts: list[Distance], resolution: int = RESOLUTION) -> Shape:
    """The largest component of the union of the parts as one closed mesh, scaled to radius 0.95."""
    from skimage.measure import marching_cubes

    axis = np.linspace(-1.05, 1.05, resolution)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    field = np.min([part(grid) for part in parts], axis=0).reshape(resolution, resolution, resolution)
    step = axis[1] - axis[0]
    positions, faces, _, _ = marching_cubes(field, 0.0, spacing=(step, step, step), gradient_direction="ascent")
    positions = positions + axis[0]
    positions, faces = _largest_component(positions, faces)
    a, b, c = (positions[faces[:, i]] for i in range(3))
    if np.einsum("ij,ij->", a, np.cross(b, c)) < 0:  # scikit-image winds triangles clockwise for some directions
        faces = faces[:, ::-1]
    distances = np.stack([part(positions) for part in parts])
    union: Distance = lambda p: np.min([part(p) for part in parts], axis=0)  # noqa: E731
    normals = _gradient(union, positions, 0.5 * step)
    center = (positions.min(axis=0) + positions.max(axis=0)) / 2
    scaled = positions - center
    scaled *= 0.95 / np.linalg.norm(scaled, axis=1).max()
    return Shape(
        scaled.astype(np.float32), normals.astype(np.float32), faces.astype(np.uint32), distances.argmin(axis=0)
    )


def _gradient(distance: Distance, points: Array, step: float) -> Array:
    offsets = np.eye(3) * step
    slope = np.stack([distance(points + offset) - distance(points - offset) for offset in offsets], axis=1)
    return slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-12)


def _largest_component(positions: Array, faces: NDArray[np.int32]) -> tuple[Array, NDArray[np.int32]]:
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    corners = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    links = coo_matrix((np.ones(len(corners)), corners.T), shape=(len(positions), len(positions)))
    _, labels = connected_components(links, directed=False)
    keep = labels == np.bincount(labels).argmax()
    index = np.cumsum(keep) - 1
    return positions[keep], index[faces[keep[faces[:, 0]]]].astype(np.int32)
