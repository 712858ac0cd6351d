"""Hulls of round and of flat bodies on a table, of many sizes: which unseen surface has an edge along its rim?

    python -m benchmarks.unseen_surface_bodies --store FILE
    python -m benchmarks.unseen_surface_bodies --table FILE

Bodies of revolution with exact masks from 24 cameras above the horizon. A body with a flat base needs a membrane, a
round one of the same size does not. Each row has the Chamfer distance of the hull as it is and with membranes across
all unseen surface, and what the rule knows of the largest unseen patch.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
import trimesh
from numpy.typing import NDArray

from benchmarks.stored_rows import add_rows, parsed, provenance
from hir_core.capture import Camera
from hir_core.metrics.surface_metrics import compare_surfaces
from hir_core.plugins.manager import PluginManager
from hir_plugins.initializers.surface import unseen_surface
from tests.fixtures.silhouette_captures import look_at, shape_capture

Points = NDArray[np.float64]

RADII = (0.05, 0.08, 0.12, 0.18, 0.25, 0.35)
"""Of rods and of standing bodies; all bodies fit into a ball of radius 1."""
SIDES = (192, 512)
"""Of the images, in pixels."""
ELEVATIONS = (3.0, 20.0)
"""Of the lowest camera, in degrees above the horizon."""
VIEWS = 24


def profiles() -> dict[str, tuple[bool, Points]]:
    """For each body whether its underside is round, and its outline: (N, 2), distance from the axis and height."""
    angle = np.linspace(0, 2 * np.pi, 49)
    half = np.linspace(-np.pi / 2, np.pi / 2, 33)
    found = {"ball 0.80": (True, 0.8 * np.stack([np.cos(half), np.sin(half)], axis=1))}
    for r in RADII:
        rod = np.stack([0.9 - r + r * np.cos(angle), r * np.sin(angle)], axis=1)
        flat = np.stack([rod[:, 0], np.maximum(rod[:, 1], 0)], axis=1)
        found[f"ring, round rod {r:.2f}"] = True, rod
        found[f"ring, half a rod {r:.2f}"] = False, flat
        height = r * np.sin(half) + np.where(half < 0, r - 0.7, 0.7 - r)
        found[f"standing, round end {r:.2f}"] = True, np.stack([r * np.cos(half), height], axis=1)
        found[f"standing, flat end {r:.2f}"] = False, np.array([[0, -0.7], [r, -0.7], [r, 0.7], [0, 0.7]])
    return found


def body_of(profile: Points) -> trimesh.Trimesh:
    """The body around +Y."""
    body = trimesh.creation.revolve(profile, sections=128)
    body.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))
    return body


def cameras_above(lowest: float, side: int) -> list[Camera]:
    """`VIEWS` cameras from `lowest` to 75 degrees above the horizon, by the golden angle."""
    turn = np.pi * (3 - np.sqrt(5))
    found = []
    for i, y in enumerate(np.linspace(np.sin(np.radians(lowest)), np.sin(np.radians(75)), VIEWS)):
        level = np.sqrt(1 - y * y)
        position = 4 * np.array([level * np.cos(turn * i), y, level * np.sin(turn * i)])
        found.append(look_at(position, np.zeros(3), 1.55 * side, side, side))
    return found


def measured(body: trimesh.Trimesh, side: int, lowest: float, plugins: PluginManager) -> dict[str, Any]:
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(body.vertices.astype(np.float32), body.faces.astype(np.uint32))

    def inside(origins: Points, directions: Points) -> NDArray[np.bool_]:
        rays = np.concatenate([np.broadcast_to(origins, directions.shape), directions], axis=1)
        return np.isfinite(scene.cast_rays(o3d.core.Tensor(rays.astype(np.float32)))["t_hit"].numpy())

    cameras = cameras_above(lowest, side)
    hull = plugins.create("initializer", "visual_hull", {"unseen_surface": "hull", "vertex_colors": False}, 0)
    _, found = hull.initialize(shape_capture(cameras, inside), None, Path("made-in-memory"))
    assert found is not None
    positions, faces = found.mesh.positions.numpy().astype(np.float64), found.mesh.faces.numpy().astype(np.int64)
    patch = unseen_surface.unseen_patches(positions, faces, cameras)
    angles = unseen_surface.rim_angles(positions, faces, patch)
    distances = unseen_surface.mean_rim_distances(faces, patch)
    spanned = unseen_surface.membranes(positions, faces, patch >= 0)
    truth = np.asarray(body.vertices, np.float64), np.asarray(body.faces, np.int64)
    # all around, so that the underside counts
    seen_by = [*cameras, *cameras_above(-60, side)]
    largest = int(np.bincount(patch[patch >= 0]).argmax()) if (patch >= 0).any() else None
    return {
        "side": side,
        "lowest_elevation": lowest,
        "vertices": len(positions),
        "chamfer_hull": round(compare_surfaces((positions, faces), truth, seen_by).chamfer, 5),
        "chamfer_membrane": round(compare_surfaces((spanned, faces), truth, seen_by).chamfer, 5),
        "largest_patch": 0 if largest is None else int((patch == largest).sum()),
        "angle": None if largest is None else round(float(angles[largest]), 1),
        "rim_distance": None if largest is None else round(float(distances[largest]), 2),
        **provenance(),
    }


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Markdown: a line for each body, side and elevation."""
    lines = [
        "| body | image | from | Chamfer: hull | membrane | angle at the rim | distance to the rim, edges | product |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        known = row["angle"] is not None
        cells = [row["body"], f"{row['side']}²", f"{row['lowest_elevation']:.0f}°"]
        cells += [f"{row['chamfer_hull']:.5f}", f"{row['chamfer_membrane']:.5f}"]
        cells += [f"{row['angle']:.0f}°", f"{row['rim_distance']:.1f}"] if known else ["–", "–"]
        cells.append(f"{row['angle'] * row['rim_distance']:.0f}" if known else "–")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", type=Path, default=Path("benchmarks/results/unseen_surface_bodies.jsonl"))
    parser.add_argument("--table", type=Path, metavar="FILE", help="print the table of stored lines, measure nothing")
    options = parsed(parser, table)
    plugins = PluginManager.discover()
    for name, (is_round, profile) in profiles().items():
        body = body_of(profile)
        for side in SIDES:
            for lowest in ELEVATIONS:
                row = {"body": name, "round": is_round, **measured(body, side, lowest, plugins)}
                add_rows(options.store, [row])


if __name__ == "__main__":
    main()
