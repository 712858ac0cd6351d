"""What measured depths with a common error do to the mesh, and how well masks determine that error.

    python -m benchmarks.measured_depths --store benchmarks/results/measured_depths.jsonl
    python -m benchmarks.measured_depths --table benchmarks/results/measured_depths.jsonl

Masks and depth maps are cast from true meshes of the tuning half of the shape benchmark; there are no photographs, so
photo-consistency is off. `none` is the visual hull without depths, `as_measured` and `auto` are `depth_maps.scale`. All
end with the geometry stage. Errors are those of the sensor at a metre: a share of the distance that all depths have in
common, and noise of 1 % that neighbours share. A row that is stored already is not measured again.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.materials.render import FIELD_OF_VIEW, spiral_camera
from benchmarks.shape.render import true_shape
from benchmarks.stored_rows import add_rows, provenance, stored_rows
from hir_core.capture import Camera, Capture, DepthPixels, MeasuredDepth, View
from hir_core.config import load_config
from hir_core.intake.depth_scale import with_depth_scale
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.metrics.surface_metrics import compare_surfaces
from hir_core.plugins.manager import PluginManager
from hir_core.run.stage_context import StageContext
from hir_core.stages.geometry.geometry_fit import fit_geometry
from hir_core.testing.captures import StoredPixels

SIDE, DEPTH_SIDE, VIEWS = 128, 96, 24
MASK_SAMPLES = 3
"""Rays along each side of a pixel of a mask."""

NOISE_LENGTH = 2.0
"""Standard deviation, in pixels of the depth map, of the smoothing that makes neighbours share errors."""

OBJECTS = ("stone", "bowl", "mug")
BIASES = (0.0, 0.01, -0.01, 0.03)
NOISES = (0.0, 0.01)
METHODS = ("none", "as_measured", "auto")


@dataclass(frozen=True)
class Case:
    """One run."""

    object: str
    bias: float
    noise: float
    method: str
    seed: int


@cache
def mesh_of(name: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices and faces of the true mesh."""
    shape = true_shape(name, 96)
    return shape.positions.astype(np.float64), np.asarray(shape.faces, dtype=np.int64)


def cast_depth(name: str, camera: Camera, samples: int = 1) -> NDArray[np.float64]:
    """Depth along the optical axis (H·samples, W·samples), 0 beside the object."""
    columns, rows = np.meshgrid(np.arange(camera.width * samples), np.arange(camera.height * samples))
    pixels = (np.stack([columns.ravel(), rows.ravel()], axis=1) + 0.5) / samples
    origins, directions = camera.rays(pixels)
    distance = MeshQueries(*mesh_of(name)).first_distances(origins, directions)
    depth = np.where(np.isfinite(distance), distance, 0) * (directions @ camera.world_to_camera[2, :3])
    return np.asarray(depth.reshape(camera.height * samples, camera.width * samples))


def square_camera(index: int, side: int) -> Camera:
    """A camera of the shape benchmark at another resolution."""
    pose = spiral_camera(index, VIEWS, "train") @ np.diag([1.0, -1.0, -1.0, 1.0])
    focal = side / 2 / np.tan(FIELD_OF_VIEW / 2)
    return Camera(np.array([[focal, 0, side / 2], [0, focal, side / 2], [0, 0, 1.0]]), np.linalg.inv(pose), side, side)


@cache
def observations(name: str) -> list[tuple[Camera, NDArray[np.float32], NDArray[np.float64]]]:
    """Cameras, masks with antialiased outlines, and exact depths of all views."""
    found = []
    for i in range(VIEWS):
        camera, n = square_camera(i, SIDE), MASK_SAMPLES
        hit = cast_depth(name, camera, n) > 0
        mask = hit.reshape(SIDE, n, SIDE, n).mean(axis=(1, 3)).astype(np.float32)
        found.append((camera, mask, cast_depth(name, square_camera(i, DEPTH_SIDE))))
    return found


def capture_of(case: Case) -> Capture:
    """Masks, and depths with the errors of the case."""
    from scipy.ndimage import gaussian_filter

    random = np.random.default_rng(case.seed)
    views = []
    for i, (camera, mask, depth) in enumerate(observations(case.object)):
        error = gaussian_filter(random.normal(size=depth.shape), NOISE_LENGTH)
        measured = (depth * (1 + case.bias) * (1 + case.noise * error / error.std())).astype(np.float32)
        pixels = DepthPixels(measured, (measured > 0).astype(np.float32))
        color = np.full((SIDE, SIDE, 3), 0.5, np.float32) * mask[..., None]
        source = MeasuredDepth(lambda found=pixels: found)  # type: ignore[misc]
        views.append(View(f"{i:03d}", camera, StoredPixels(color, mask), depth=source))
    return Capture(Path(case.object), tuple(views))


def measured(case: Case, plugins: PluginManager) -> dict[str, Any]:
    """Errors of the mesh of a case, in the world's unit: objects have a radius of about 1."""
    capture, scale = capture_of(case), None
    began = time.process_time()
    if case.method == "auto":
        capture, scale = with_depth_scale(capture)
    scale_seconds = time.process_time() - began
    settings = replace(load_config(plugins).geometry, photo_consistency="off")
    name = "sensor_depth"
    if case.method == "none":
        settings, name = replace(settings, depth_weight=0.0), "visual_hull"
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "checkpoints").mkdir()
        initializer = plugins.create("initializer", name, {"vertex_colors": False}, case.seed)
        _, scene = initializer.initialize(capture, None, Path(folder))
        fitted, report = fit_geometry(scene, capture, settings, StageContext(plugins, Path(folder), seed=case.seed))
    mesh = fitted.scene.mesh
    arrays = (mesh.positions.detach().numpy().astype(np.float64), mesh.faces.numpy())
    figures = compare_surfaces(arrays, mesh_of(case.object), capture.cameras)
    return {
        "object": case.object,
        "bias": case.bias,
        "noise": case.noise,
        "method": case.method,
        "seed": case.seed,
        "chamfer": round(figures.chamfer, 6),
        "completeness": round(figures.completeness, 6),
        "iou_held_out": report.iou_held_out.after,
        "factor": None if scale is None else scale.factor,
        "standard_error": None if scale is None else scale.standard_error,
        "scale_seconds": round(scale_seconds, 2),
        "cpu_seconds": round(time.process_time() - began, 1),
        **provenance(),
    }


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """A Markdown table: a line for each object, bias and noise."""
    lines = [
        "| object | noise | bias | none | as measured | corrected | depths after correction | held-out IoU |",
        "|---|---|---|---|---|---|---|---|",
    ]
    found = {(r["object"], r["noise"], r["bias"], r["method"]): r for r in rows}
    for name, noise, bias in sorted({key[:3] for key in found if key[3] == "auto"}):
        without = found.get((name, 0.0, 0.0, "none"))
        three = [without, found.get((name, noise, bias, "as_measured")), found[name, noise, bias, "auto"]]
        corrected = three[2]
        assert corrected is not None
        errors = " | ".join("–" if row is None else f"{row['completeness']:.4f}" for row in three)
        overlap = " / ".join("–" if row is None else f"{row['iou_held_out']:.4f}" for row in three)
        left = (1 + bias) * corrected["factor"] - 1
        lines.append(
            f"| {name} | {noise:.0%} | {bias:+.0%} | {errors} | {left:+.2%} ± {corrected['standard_error']:.2%} | "
            f"{overlap} |"
        )
    return "\n".join(lines)


def cases(seed: int) -> list[Case]:
    """Without depths once for each object, as errors of depths do not matter there."""
    found = []
    for bias in BIASES:
        for noise in NOISES:
            for name in OBJECTS:
                for method in METHODS:
                    if method != "none" or (bias, noise) == (0.0, 0.0):
                        found.append(Case(name, bias, noise, method, seed))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", type=Path, default=Path("benchmarks/results/measured_depths.jsonl"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--table", type=Path, metavar="FILE", help="print the table of stored lines, measure nothing")
    options = parser.parse_args()
    if options.table is not None:
        print(table(stored_rows(options.table)))
        return
    plugins = PluginManager.discover()
    names = ("object", "bias", "noise", "method", "seed")
    known = {tuple(row[name] for name in names) for row in stored_rows(options.store)}
    for case in cases(options.seed):
        if (case.object, case.bias, case.noise, case.method, case.seed) not in known:
            add_rows(options.store, [measured(case, plugins)])


if __name__ == "__main__":
    main()
