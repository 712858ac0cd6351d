"""The geometry stage on real captures: `python -m benchmarks.geometry_fit CAPTURE… [--start sphere|hull]`, Markdown.

The start is a sphere or a visual hull of voxels four pixels wide. The fit sees the train split alone. Measured on the
test split and the capture's true mesh or pictures: IoU (coverage and mask thresholded at one half), the outline's mean
signed offset (difference of areas over the mask's outline), Chamfer distance (mean of both directions, in radii,
between 100,000 points on each surface), median angle of the normals and mean error of depth. Seconds are CPU seconds of
the stage, with as many threads as OMP_NUM_THREADS allows.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.true_depth_and_normals import PictureErrors, picture_errors
from hir_core.capture import Capture
from hir_core.config import load_config
from hir_core.intake.reader_lookup import read_capture
from hir_core.mesh.mesh_validity import inspect_mesh
from hir_core.plugins.manager import PluginManager
from hir_core.run.stage_context import StageContext
from hir_core.scene import Mesh, Scene
from hir_core.stages.geometry.geometry_fit import fit_geometry
from hir_plugins.geometry_renderers.contour import Contour
from hir_plugins.geometry_renderers.options import ContourOptions
from tests.fixtures.meshes import icosphere, mesh_of


@dataclass(frozen=True)
class Figures:
    """Errors on views and surfaces that the fit does not use."""

    iou: float
    offset_px: float
    chamfer: float | None
    pictures: PictureErrors | None


def silhouette_figures(mesh: Mesh, test: Capture) -> tuple[float, float]:
    """Mean IoU, and mean signed offset of the outline in pixels (positive: too large)."""
    renderer = Contour(ContourOptions(render_lines=8))
    fixed = mesh.with_positions(mesh.positions.detach())
    ious, offsets = [], []
    for view, camera in zip(test.views, test.cameras, strict=True):
        mask = torch.from_numpy(np.asarray(view.pixels().mask))
        found = renderer.render(fixed, [camera])[0]
        ious.append(float(((found > 0.5) & (mask > 0.5)).sum() / ((found > 0.5) | (mask > 0.5)).sum()))
        # the length of the outline: the total variation of the mask
        length = torch.hypot(*torch.gradient(mask)).sum()
        offsets.append(float((found - mask).sum() / length))
    return float(np.mean(ious)), float(np.mean(offsets))


def chamfer(mesh: Mesh, true: tuple[NDArray[np.float64], NDArray[np.int64]]) -> float:
    """Mean of the mean distances from either surface to the other."""
    import trimesh
    from scipy.spatial import cKDTree

    fitted = trimesh.Trimesh(mesh.positions.detach().numpy(), mesh.faces.numpy(), process=False)
    a = fitted.sample(100_000, seed=1)
    b = trimesh.Trimesh(*true, process=False).sample(100_000, seed=2)
    return float(0.5 * (cKDTree(a).query(b)[0].mean() + cKDTree(b).query(a)[0].mean()))


def true_mesh(path: Path, test: Capture) -> tuple[NDArray[np.float64], NDArray[np.int64]] | None:
    """`reference.obj` in our axes, where the capture has one; for evaluation only."""
    import trimesh

    if not path.is_file():
        return None
    loaded = trimesh.load(path, process=False, force="mesh")
    moved = np.asarray(loaded.vertices) @ test.world_from_source[:3, :3].T + test.world_from_source[:3, 3]
    return moved, np.asarray(loaded.faces)


def start_mesh(kind: str, capture: Capture, plugins: PluginManager, workspace: Path) -> Scene:
    """A sphere of radius 0.8 about the origin, or the hull."""
    if kind == "sphere":
        positions, faces = icosphere(4)
        return Scene(mesh_of(positions * 0.8, faces))
    hull = plugins.create("initializer", "visual_hull", {"pixels_per_voxel": 4.0, "vertex_colors": False})
    _, scene = hull.initialize(capture, None, workspace)
    return scene


def figures(mesh: Mesh, test: Capture, true: tuple[NDArray[np.float64], NDArray[np.int64]] | None) -> Figures:
    """All of them."""
    distance = None if true is None else chamfer(mesh, true)
    return Figures(*silhouette_figures(mesh, test), distance, picture_errors(mesh, test))


def pair(before: float | None, after: float | None, form: str) -> str:
    """A cell of the table."""
    return "–" if before is None or after is None else f"{before:{form}} → {after:{form}}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("captures", nargs="+", type=Path)
    parser.add_argument("--start", choices=("hull", "sphere"), default="hull")
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--set", action="append", default=[], dest="assignments")
    options = parser.parse_args()
    plugins = PluginManager.discover()
    settings = load_config(plugins, preset=options.preset, assignments=options.assignments).geometry
    titles = [
        "capture",
        "start",
        "CPU s",
        "IoU test",
        "offset, px",
        "Chamfer",
        "normals, °",
        "depth",
        "triangles",
        "genus",
        "self-intersecting",
    ]
    print(f"| {' | '.join(titles)} |\n|{'---|' * len(titles)}", flush=True)
    for path in options.captures:
        train, test = (read_capture(path, split, plugins) for split in ("train", "test"))
        true = true_mesh(path / "reference.obj", test)
        with tempfile.TemporaryDirectory() as folder:
            scene = start_mesh(options.start, train, plugins, Path(folder))
            context = StageContext(plugins, Path(folder), warn=lambda sentence: print(f"> {sentence}"))
            clock = time.process_time()
            fitted = fit_geometry(scene, train, settings, context)[0].scene
            seconds = time.process_time() - clock
        before, after = figures(scene.mesh, test, true), figures(fitted.mesh, test, true)
        state = inspect_mesh(fitted.mesh.positions.double().numpy(), fitted.mesh.faces.numpy())
        old, new = before.pictures, after.pictures
        cells = [
            path.name,
            options.start,
            f"{seconds:.0f}",
            pair(before.iou, after.iou, ".4f"),
            pair(before.offset_px, after.offset_px, "+.3f"),
            pair(before.chamfer, after.chamfer, ".4f"),
            pair(old.normal_degrees if old else None, new.normal_degrees if new else None, ".1f"),
            pair(old.depth if old else None, new.depth if new else None, ".4f"),
            str(state.triangles),
            str(state.genus),
            str(state.self_intersecting),
        ]
        print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
