"""First meshes: chains of initializers against the true mesh, as photographs become more."""

from __future__ import annotations

import tempfile
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from hir_core.bench.captures import true_mesh
from hir_core.bench.measure import peak_bytes, reset_peak
from hir_core.bench.plan import Plan
from hir_core.bench.results import Case, Row, Timing
from hir_core.capture import Capture
from hir_core.errors import HirError
from hir_core.evaluation import spread
from hir_core.metrics.surfaces import compare_surfaces
from hir_core.pixel_cache import PixelCache
from hir_core.readers import read_capture
from hir_core.scene import Scene

VIEWS = (20, 40, 80)


def initializers(plan: Plan) -> Iterator[Row]:
    """Rows for each capture with known cameras and a true mesh, each number of views and each chain."""
    for path in plan.captures:
        whole = read_capture(path, "train", plan.plugins)
        test = read_capture(path, "test", plan.plugins)
        truth = true_mesh(path, test)
        if truth is None or any(view.camera is None for view in whole.views):
            continue
        last: dict[str, Timing] = {}
        for count in VIEWS[:1] if plan.quick else VIEWS:
            if count > len(whole.views):
                continue
            capture = decoded(replace(whole, views=tuple(whole.views[i] for i in spread(len(whole.views), count))))
            case: Case = {"capture": path.name, "views": count}
            for chain in chains(plan, capture):
                label = ", ".join(chain)
                if plan.too_slow(last.get(label), 2):
                    yield Row(case, label, "ours", None, note=plan.left_out(last[label]))
                    continue
                try:
                    scene, last[label] = run(chain, capture, plan)
                except HirError as error:
                    yield Row(case, label, "ours", None, note=f"no mesh: {error}")
                    continue
                mesh = (scene.mesh.positions.detach().numpy(), scene.mesh.faces.numpy())
                found = compare_surfaces(mesh, truth, test.cameras)
                errors = {
                    "Chamfer, radii": found.chamfer, "accuracy": found.accuracy, "completeness": found.completeness,
                    "normals, °": found.normal_error_deg,
                }  # fmt: skip
                yield Row(case, label, "ours", last[label], errors, "truth that unseen views see")


def chains(plan: Plan, capture: Capture) -> list[tuple[str, ...]]:
    """What is suggested for the capture; each that makes a surface by itself, and each after the suggested chain."""
    surfaces = [
        r.component.name for r in plan.plugins.components("initializer")
        if {"makes_surface"} <= r.component.traits and "reads_files" not in r.component.traits and not r.missing
    ]  # fmt: skip
    suggested = tuple(plan.plugins.suggest_initializers(capture))
    found = [suggested, *((name,) for name in surfaces), *((*suggested, n) for n in surfaces if n not in suggested)]
    return list(dict.fromkeys(chain for chain in found if chain))


def run(chain: Sequence[str], capture: Capture, plan: Plan) -> tuple[Scene, Timing]:
    """The chain's scene; one run, photographs decoded beforehand, vertex colours left out where that can be."""
    scene: Scene | None = None
    before = reset_peak()
    wall, cpu = time.perf_counter(), time.process_time()
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in chain:
            config = plan.plugins.find("initializer", name).component.config
            known = getattr(config, "__dataclass_fields__", {})
            options = {"vertex_colors": False} if "vertex_colors" in known else {}
            capture, scene = plan.plugins.create("initializer", name, options).initialize(capture, scene, Path(folder))
    seconds, after = time.perf_counter() - wall, peak_bytes()
    memory = None if before is None or after is None else max(0, after - before)
    if scene is None:
        raise HirError(f"{', '.join(chain)} made no surface")
    return scene, Timing(seconds, seconds, seconds, 1, time.process_time() - cpu, memory)


def decoded(capture: Capture) -> Capture:
    """With photographs in memory, so that decoding is not timed."""
    cached = PixelCache().wrap(capture)
    for view in cached.views:
        view.pixels()
    return cached
