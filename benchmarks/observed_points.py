"""Surface points of a finished run that unseen views see, with the observation of each by every photograph.

They show what limits a fit: how well photographs that are blended on the mesh predict the unseen views
(`blend_photographs`), how well one colour for all directions does, and what each part of a reflectance model gains
(`benchmarks.point_models`), without textures, their resolution or a solver.

    python -m benchmarks.observed_points CAPTURE RUN
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from hir_exporters.asset import AssetMesh
from hir_exporters.conventions import linear_to_srgb
from hir_exporters.scene_format import load_scene
from numpy.typing import NDArray

from hir_core.capture import Camera
from hir_core.intake.reader_lookup import read_capture
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.plugins.manager import PluginManager

Array = NDArray[np.floating]

POINTS_PER_VIEW = 4000
MIN_COVERAGE = 0.99
MIN_VIEW_COSINE = 0.15
"""Photographs that see a point at a smaller cosine are ignored."""
RAY_OFFSET = 1e-3
"""Of the object's size: height above the surface at which a shadow ray starts."""


@dataclass(frozen=True)
class ObservedPoints:
    """N points, T train views; colours are linear, directions lead to the camera."""

    normals: Array
    """Interpolated, (N, 3)."""
    color: Array
    """In the unseen view, (N, 3)."""
    direction: Array
    """To the unseen view, (N, 3)."""
    colors: Array
    """In each photograph, (N, T, 3)."""
    directions: Array
    """(N, T, 3)."""
    observed: NDArray[np.bool_]
    """Whether a photograph observes the point, (N, T)."""


def observed_points(capture: Path, run: Path, plugins: PluginManager, seed: int = 0) -> ObservedPoints:
    """Some points of each test view, drawn with `seed`."""
    train, test = (read_capture(capture, split, plugins) for split in ("train", "test"))
    mesh = load_scene(run / "scene").mesh
    rays, size = MeshQueries(mesh.positions, mesh.faces), float(np.ptp(mesh.positions, axis=0).max())
    photographs = [view.pixels() for view in train.views]
    random = np.random.default_rng(seed)
    parts = []
    for view, camera in zip(test.views, test.cameras, strict=True):
        pixels = view.pixels()
        assert pixels.mask is not None
        rows, columns = np.nonzero(pixels.mask >= MIN_COVERAGE)
        drawn = random.choice(len(rows), min(POINTS_PER_VIEW, len(rows)), replace=False)
        rows, columns = rows[drawn], columns[drawn]
        hit, toward, points, normals, flat = surface_under_pixels(camera, rows, columns, mesh, rays)
        above = points + RAY_OFFSET * size * flat
        found = [
            observe(points, above, flat, camera, p.color_linear, p.mask, rays)
            for camera, p in zip(train.cameras, photographs, strict=True)
        ]
        colors, directions, observed = (np.stack([f[k] for f in found], axis=1) for k in range(3))
        color = pixels.color_linear[rows, columns][hit]
        parts.append((normals, color, -toward, colors, directions, observed))
    return ObservedPoints(*(np.concatenate([part[k] for part in parts]) for k in range(6)))


def surface_under_pixels(
    camera: Camera, rows: NDArray[np.intp], columns: NDArray[np.intp], mesh: AssetMesh, rays: MeshQueries
) -> tuple[NDArray[np.bool_], Array, Array, Array, Array]:
    """Which of P pixels hit the mesh (P,); for the N that do: ray direction, point, interpolated normal and normal of
    the triangle, each (N, 3).
    """
    origin, toward = camera.rays(np.stack([columns, rows], axis=1) + 0.5)
    face, weights = rays.first_hits(np.broadcast_to(origin, toward.shape).astype(np.float32), toward)
    hit = face >= 0
    corners, weight = mesh.faces[face[hit]], weights[hit][..., None]
    edges = np.diff(mesh.positions[corners], axis=1)
    flat = np.cross(edges[:, 0], edges[:, 1])
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-30)
    points, normals = ((values[corners] * weight).sum(axis=1) for values in (mesh.positions, mesh.normals))
    return hit, toward[hit], points, normals, flat


def observe(
    points: Array, above: Array, flat: Array, camera: Camera, color: Array, mask: Array | None, rays: MeshQueries
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Colours (N, 3) of points in one photograph, directions to it, and whether it observes them."""
    toward = camera.center - points
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    position, depth = camera.project(points)
    inside = (depth > 0) & (position > 1).all(axis=1) & (position < [camera.width - 1, camera.height - 1]).all(axis=1)
    x, y = np.where(inside[:, None], position - 0.5, 0).T
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    across, down = (x - column)[:, None], (y - row)[:, None]

    def read(image: Array) -> Array:
        upper = image[row, column] * (1 - across) + image[row, column + 1] * across
        lower = image[row + 1, column] * (1 - across) + image[row + 1, column + 1] * across
        return upper * (1 - down) + lower * down

    covered = np.ones(len(points)) if mask is None else read(mask[..., None])[:, 0]
    observed = inside & (covered >= MIN_COVERAGE) & ((flat * toward).sum(axis=1) > MIN_VIEW_COSINE)
    observed &= ~rays.occluded(above.astype(np.float32), toward.astype(np.float32))
    return read(color), toward, observed


def blend_photographs(points: ObservedPoints, falloff: float, nearest: int = 0) -> Array:
    """Mean colour (N, 3) of the photographs, weighted by 1 / (angle² + `falloff`²) in radians
    from the unseen view; only the `nearest` ones where that is not 0.
    """
    cosine = np.clip((points.directions * points.direction[:, None]).sum(axis=2), -1, 1)
    angle = np.where(points.observed, np.arccos(cosine), np.inf)
    last = np.partition(angle, nearest - 1, axis=1)[:, [nearest - 1]] if nearest else np.inf
    weight = (points.observed & (angle <= last)) / (np.where(points.observed, angle, 0) ** 2 + falloff**2)
    return np.asarray((points.colors * weight[..., None]).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-12)[:, None])


def decibels(points: ObservedPoints, color: Array) -> float:
    """PSNR of linear colours (N, 3) in sRGB, over the points that some photograph observes."""
    known = points.observed.any(axis=1)
    difference = linear_to_srgb(np.clip(color, 0, 1)) - linear_to_srgb(np.clip(points.color, 0, 1))
    return float(-10 * np.log10(np.square(difference[known]).mean()))


def main() -> None:
    capture, run = map(Path, sys.argv[1:3])
    points = observed_points(capture, run, PluginManager.discover())
    print(f"{len(points.color):,} points, {points.observed.sum(axis=1).mean():.1f} photographs each")
    for name, falloff, nearest in (
        ("one colour for all directions", 1e3, 0),
        ("photographs blended, 0.03 rad", 0.03, 0),
        ("the four nearest blended", 0.01, 4),
    ):
        print(f"{name}: {decibels(points, blend_photographs(points, falloff, nearest)):.2f} dB")


if __name__ == "__main__":
    main()
