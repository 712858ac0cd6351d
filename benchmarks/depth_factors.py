"""How well masks determine a common factor of measured depths, on clean and on disturbed captures; no mesh is fitted.

    python -m benchmarks.depth_factors stone bowl … --store benchmarks/results/depth_factors.jsonl
    python -m benchmarks.depth_factors --table benchmarks/results/depth_factors.jsonl

The captures are those of `benchmarks.measured_depths` with depths 1 % too long. A row that is stored already is not
measured again.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measured_depths import VIEWS, Case, capture_of
from benchmarks.shape.shapes import OBJECTS
from benchmarks.stored_rows import add_rows, provenance, stored_rows
from hir_core.capture import Capture, DepthPixels, MeasuredDepth, View
from hir_core.intake.depth_scale import depth_scale
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.stages.geometry.measured_depths.depth_term import depth_rays
from hir_core.testing.captures import StoredPixels
from hir_plugins.initializers.hull.visual_hull import VisualHull
from hir_plugins.initializers.options import VisualHullOptions

BIAS = 0.01
POSE_ERROR = 0.01
"""Standard deviation of each coordinate of a camera's position, in radii of the object: one pixel of the masks."""

Views = tuple[View, ...]


def _clean(views: Views) -> Views:
    return views


def _masks(grow: bool) -> Callable[[Views], Views]:
    """Outlines one pixel further out or in, in all views."""

    def disturbed(views: Views) -> Views:
        from scipy.ndimage import grey_dilation, grey_erosion

        moved = grey_dilation if grow else grey_erosion
        found = []
        for view in views:
            pixels = view.pixels()
            mask = moved(pixels.mask, footprint=np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]]))
            found.append(replace(view, read=StoredPixels(pixels.color_linear, mask.astype(np.float32))))
        return tuple(found)

    return disturbed


def _wrong_masks(views: Views) -> Views:
    """Two masks are twelve pixels beside the object."""
    found = list(views)
    for i in (VIEWS // 5, 3 * VIEWS // 5):
        pixels = found[i].pixels()
        assert pixels.mask is not None
        found[i] = replace(found[i], read=StoredPixels(pixels.color_linear, np.roll(pixels.mask, 12, axis=1)))
    return tuple(found)


def _moved_cameras(views: Views) -> Views:
    random, found = np.random.default_rng(1), []
    for view in views:
        assert view.camera is not None
        pose = view.camera.world_to_camera.copy()
        pose[:3, 3] += random.normal(size=3) * POSE_ERROR
        found.append(replace(view, camera=replace(view.camera, world_to_camera=pose)))
    return tuple(found)


def _depths(change: Callable[[DepthPixels], DepthPixels]) -> Callable[[Views], Views]:
    def disturbed(views: Views) -> Views:
        found = []
        for view in views:
            assert view.depth is not None
            pixels = change(view.depth.read())
            found.append(replace(view, depth=MeasuredDepth(lambda pixels=pixels: pixels)))  # type: ignore[misc]
        return tuple(found)

    return disturbed


def _stripes(pixels: DepthPixels) -> DepthPixels:
    """A third of the depths is 5 % too long."""
    wrong = np.broadcast_to(np.arange(pixels.depth.shape[1]) % 24 < 8, pixels.depth.shape)
    return replace(pixels, depth=np.where(wrong, pixels.depth * 1.05, pixels.depth).astype(np.float32))


def _coarse(pixels: DepthPixels) -> DepthPixels:
    return DepthPixels(pixels.depth[1::3, 1::3], pixels.confidence[1::3, 1::3])


def _one_side(views: Views) -> Views:
    """The third of the views that is nearest to one of them in direction."""
    centers = np.array([view.camera.center for view in views if view.camera is not None])
    near = np.argsort(-(centers @ centers[VIEWS // 3]))[: VIEWS // 3]
    return tuple(views[i] for i in sorted(near))


DISTURBANCES: Mapping[str, tuple[float, Callable[[Views], Views]]] = {
    "exact depths": (0.0, _clean),
    "exact depths, 12 views from above": (0.0, lambda views: views[VIEWS // 2 :]),
    "noise of 1 %": (0.01, _clean),
    "noise, maps of 32²": (0.01, _depths(_coarse)),
    "noise, 8 of 24 views": (0.01, lambda views: views[::3]),
    "noise, the 8 views of one side": (0.01, _one_side),
    "noise, two wrong masks": (0.01, _wrong_masks),
    "noise, cameras off by a pixel": (0.01, _moved_cameras),
    "noise, outlines a pixel out": (0.01, _masks(grow=True)),
    "noise, outlines a pixel in": (0.01, _masks(grow=False)),
    "noise, a third 5 % too long": (0.01, _depths(_stripes)),
}
"""Noise of the depths, and what else is wrong."""


def hull_median(views: Views) -> float:
    """The factor by a simpler estimate: the median over all depths of the depth of the hull over the measured one."""
    hull = VisualHull(VisualHullOptions(vertex_colors=False))
    _, scene = hull.initialize(Capture(Path("hull"), views), None, Path())
    rays = depth_rays(views, 1.0, seed=0)
    assert scene is not None and rays is not None
    queries = MeshQueries(scene.mesh.positions.numpy(), scene.mesh.faces.numpy())
    reached = queries.first_distances(rays.origins, rays.directions)
    hit = np.isfinite(reached)
    return float(np.median(reached[hit] / np.linalg.norm(rays.points - rays.origins, axis=1)[hit]))


def measured(name: str, disturbance: str, seed: int) -> dict[str, Any]:
    """The error that is left after the correction; `left` is that of the uncorrected depths where it is not made."""
    noise, change = DISTURBANCES[disturbance]
    views = change(capture_of(Case(name, BIAS, noise, "auto", seed)).views)
    scale = depth_scale(views)
    return {
        "object": name,
        "half": OBJECTS[name].half,
        "disturbance": disturbance,
        "seed": seed,
        "left": (1 + BIAS) * scale.factor - 1,
        "standard_error": scale.standard_error,
        "corrected": scale.factor != 1,
        "rays": scale.rays,
        "left_by_hull_median": None if noise else (1 + BIAS) * hull_median(views) - 1,
        **provenance(),
    }


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """A Markdown table: a line for each disturbance, over the objects of each half."""
    lines = [
        "| capture | half | corrected | left, mean ± deviation | largest | standard error | by the hull's median |",
        "|---|---|---|---|---|---|---|",
    ]
    for disturbance in DISTURBANCES:
        for half in ("tuning", "validation"):
            chosen = [row for row in rows if (row["disturbance"], row["half"]) == (disturbance, half)]
            done = [row for row in chosen if row["corrected"]]
            if not done:
                continue
            left = np.array([row["left"] for row in done])
            error = np.mean([row["standard_error"] for row in done])
            simpler = [row["left_by_hull_median"] for row in chosen if row["left_by_hull_median"] is not None]
            worst = f"{max(simpler, key=abs):+.2%}" if simpler else "–"
            lines.append(
                f"| {disturbance} | {half} | {len(done)} of {len(chosen)} | {left.mean():+.2%} ± {left.std():.2%} | "
                f"{left[np.abs(left).argmax()]:+.2%} | {error:.2%} | {worst} |"
            )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("objects", nargs="*", help="of the shape benchmark")
    parser.add_argument("--store", type=Path, default=Path("benchmarks/results/depth_factors.jsonl"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--table", type=Path, metavar="FILE", help="print the table of stored lines, measure nothing")
    options = parser.parse_args()
    if options.table is not None:
        print(table(stored_rows(options.table)))
        return
    known = {(row["object"], row["disturbance"], row["seed"]) for row in stored_rows(options.store)}
    for name in options.objects:
        for disturbance in DISTURBANCES:
            if (name, disturbance, options.seed) not in known:
                add_rows(options.store, [measured(name, disturbance, options.seed)])


if __name__ == "__main__":
    main()
