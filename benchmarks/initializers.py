"""Initial meshes against the truth: `python -m benchmarks.initializers CAPTURE… [--sweep]`, Markdown tables.

Captures with known cameras, masks and a true mesh (`reference.obj`). An initializer sees the train split alone. Chamfer
is the mean of both directions, in radii of the object, between 100,000 points on each surface: accuracy from the mesh
to the truth, completeness back. `in front` is the share of object pixels of the test views where the mesh lies more
than 0.02 radii in front of the truth: dents that are filled. Seconds are CPU seconds of the last initializer of a
chain, without reading photographs, with as many threads as OMP_NUM_THREADS allows. `--sweep` varies stereo's resolution
and the number of photographs.
"""

from __future__ import annotations

import argparse
import tempfile
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.geometry_fit import true_mesh
from hir_core.capture import Array, Capture
from hir_core.intake.reader_lookup import read_capture
from hir_core.plugins.manager import PluginManager
from hir_core.scene import Scene
from hir_plugins.initializers.surface.swept_surface import SweptSurface

Mesh = tuple[Array, NDArray[np.int64]]

CHAINS: tuple[tuple[str, tuple[tuple[str, Mapping[str, Any]], ...]], ...] = (
    ("visual_hull", (("visual_hull", {}),)),
    ("visual_hull, stereo", (("visual_hull", {}), ("stereo", {}))),
    ("visual_hull, stereo, judge=false", (("visual_hull", {}), ("stereo", {"judge": False}))),
    ("stereo, poisson", (("stereo", {"surface": "poisson"}),)),
)


@dataclass(frozen=True)
class Figures:
    """Against the true mesh."""

    accuracy: float
    completeness: float
    in_front: float

    @property
    def chamfer(self) -> float:
        return 0.5 * (self.accuracy + self.completeness)


def figures(mesh: Mesh, truth: Mesh, test: Capture) -> Figures:
    """Distances in radii of the truth, and the share of filled pixels."""
    import trimesh
    from scipy.spatial import cKDTree

    radius = 0.5 * float(np.linalg.norm(np.ptp(truth[0], axis=0)))
    a = trimesh.Trimesh(*mesh, process=False).sample(100_000, seed=1)
    b = trimesh.Trimesh(*truth, process=False).sample(100_000, seed=2)
    found, true = SweptSurface(*mesh), SweptSurface(*truth)
    filled = total = 0
    for camera in test.cameras[::2]:
        ours, theirs = (surface.inverse_depth(camera).astype(np.float64) for surface in (found, true))
        both = (ours > 0) & (theirs > 0)
        filled += int((1 / theirs[both] - 1 / ours[both] > 0.02 * radius).sum())
        total += int(both.sum())
    return Figures(
        float(cKDTree(b).query(a)[0].mean()) / radius, float(cKDTree(a).query(b)[0].mean()) / radius, filled / total
    )


def mesh_of(scene: Scene) -> Mesh:
    """Positions and triangles."""
    return scene.mesh.positions.detach().cpu().numpy().astype(np.float64), scene.mesh.faces.cpu().numpy()


def run(
    name: str, options: Mapping[str, Any], capture: Capture, scene: Scene | None, plugins: PluginManager
) -> tuple[Scene, float]:
    """One initializer, without colours; its scene and CPU seconds."""
    initializer = plugins.create("initializer", name, {"vertex_colors": False, **options})
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        clock = time.process_time()
        _, made = initializer.initialize(capture, scene, Path(folder))
        return made, time.process_time() - clock


def in_memory(capture: Capture) -> Capture:
    """With decoded photographs, so that decoding is not timed."""
    from hir_core.capture.pixel_cache import PixelCache

    cached = PixelCache().wrap(capture)
    for view in cached.views:
        view.pixels()
    return cached


def row(label: str, seconds: float, found: Figures) -> str:
    return (
        f"{label} | {seconds:.1f} | {found.chamfer:.4f} | {found.accuracy:.4f} | {found.completeness:.4f} "
        f"| {found.in_front:.1%} |"
    )


def thinned(capture: Capture, count: int) -> Capture:
    """Views spread evenly over the capture's order."""
    chosen = np.unique(np.round(np.linspace(0, len(capture.views) - 1, count)).astype(int))
    return replace(capture, views=tuple(capture.views[i] for i in chosen))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("captures", nargs="+", type=Path)
    parser.add_argument("--sweep", action="store_true", help="Vary stereo's resolution and the number of views.")
    options = parser.parse_args(arguments)
    plugins = PluginManager.discover()
    first = "views | side, px" if options.sweep else "chain"
    print(f"| capture | {first} | CPU s | Chamfer | accuracy | completeness | in front |")
    print("|---|---|---|---|---|---|---|" + ("---|" if options.sweep else ""), flush=True)
    for path in options.captures:
        capture = in_memory(read_capture(path, "train", plugins))
        test = read_capture(path, "test", plugins)
        truth = true_mesh(path / "reference.obj", test)
        if truth is None:
            parser.error(f"{path} has no reference.obj to compare with")
        if not options.sweep:
            for label, chain in CHAINS:
                scene, seconds = None, 0.0
                for name, given in chain:
                    scene, seconds = run(name, given, capture, scene, plugins)
                assert scene is not None
                print(f"| {path.name} | {row(label, seconds, figures(mesh_of(scene), truth, test))}", flush=True)
            continue
        for count in (20, 40, len(capture.views)):
            fewer = thinned(capture, count)
            hull, _ = run("visual_hull", {}, fewer, None, plugins)
            for size, levels in ((256, 2), (512, 3)):
                scene, seconds = run("stereo", {"max_image_size": size, "levels": levels}, fewer, hull, plugins)
                label = f"{path.name} | {len(fewer.views)} | {size}"
                print(f"| {row(label, seconds, figures(mesh_of(scene), truth, test))}", flush=True)


if __name__ == "__main__":
    main()
