"""First meshes: chains of initializers against the true mesh, as photographs become more."""

from __future__ import annotations

import tempfile
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from hir_core.capture import Capture
from hir_core.errors import HirError
from hir_core.evaluation import spread
from hir_core.intake.reader_lookup import read_capture
from hir_core.metrics.surface_metrics import compare_surfaces
from hir_core.scene import Scene
from hir_plugins.commands.bench.bench_plan import Plan
from hir_plugins.commands.bench.inputs.bench_captures import decoded, true_mesh
from hir_plugins.commands.bench.measurement import peak_bytes, reset_peak
from hir_plugins.commands.bench.results.bench_result import Case, Row, Timing

VIEWS = (20, 80)

Step = tuple[str, Mapping[str, Any]]
"""An initializer and its options."""

VARIANTS: Mapping[str, Sequence[Mapping[str, Any]]] = {"stereo": ({"surface": "tsdf"},)}
"""Options that make another method of an initializer."""


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
                label = ", ".join(" ".join((name, *map(str, options.values()))) for name, options in chain)
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
                    "Chamfer, radii": found.chamfer,
                    "accuracy": found.accuracy,
                    "completeness": found.completeness,
                    "normals, °": found.normal_error_deg,
                }
                yield Row(case, label, "ours", last[label], errors, "truth that unseen views see")


def chains(plan: Plan, capture: Capture) -> list[tuple[Step, ...]]:
    """The chain that is suggested for the capture; each initializer that makes a surface, alone where it can be, else
    after one that measures points; each after the suggested chain; and variants of those."""
    known = {
        r.component.name: r.component.traits
        for r in plan.plugins.components("initializer")
        if not r.missing and "reads_files" not in r.component.traits
    }
    suggested: tuple[Step, ...] = tuple((name, {}) for name in plan.plugins.suggest_initializers(capture))
    measuring: list[Step] = [(name, {}) for name, traits in known.items() if "measures_points" in traits]
    found = [suggested]
    for name in (name for name, traits in known.items() if "makes_surface" in traits):
        before = [(step,) for step in measuring] if "needs_points" in known[name] else [()]
        found += [(*steps, (name, options)) for steps in before for options in ({}, *VARIANTS.get(name, ()))]
        if name not in dict(suggested):
            found += [(*suggested, *steps, (name, {})) for steps in before]
    return [chain for i, chain in enumerate(found) if chain and chain not in found[:i]]


def run(chain: Sequence[Step], capture: Capture, plan: Plan) -> tuple[Scene, Timing]:
    """The chain's scene; one run, photographs decoded beforehand, vertex colours left out where that can be."""
    scene: Scene | None = None
    before = reset_peak()
    wall, cpu = time.perf_counter(), time.process_time()
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, options in chain:
            config = plan.plugins.find("initializer", name).component.config
            known = getattr(config, "__dataclass_fields__", {})
            options = {**options, **({"vertex_colors": False} if "vertex_colors" in known else {})}
            capture, scene = plan.plugins.create("initializer", name, options).initialize(capture, scene, Path(folder))
    seconds, after = time.perf_counter() - wall, peak_bytes()
    memory = None if before is None or after is None else max(0, after - before)
    if scene is None:
        raise HirError(f"{', '.join(name for name, _ in chain)} made no surface")
    return scene, Timing(seconds, seconds, seconds, 1, time.process_time() - cpu, memory)
