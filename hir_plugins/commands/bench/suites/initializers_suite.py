"""Initial meshes: chains of initializers against the true mesh, at growing numbers of photographs."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from hir_core.capture import Capture
from hir_core.errors import HirError
from hir_core.intake.reader_lookup import read_capture
from hir_core.metrics.surface_metrics import compare_surfaces
from hir_core.rendering.view_selection import evenly_spaced_indices
from hir_core.scene import Scene
from hir_plugins.commands.bench.bench_options import BenchOptions
from hir_plugins.commands.bench.inputs.bench_captures import decode_images, true_mesh
from hir_plugins.commands.bench.measurement import Stopwatch
from hir_plugins.commands.bench.results.bench_result import Case, Row, Timing

VIEW_COUNTS: Final = (20, 80)

ChainStep = tuple[str, Mapping[str, Any]]
"""The name of an initializer and its options."""

VARIANTS: Final[Mapping[str, Sequence[Mapping[str, Any]]]] = {"stereo": ({"surface": "tsdf"},)}
"""Options that select another method of an initializer."""


def initializer_rows(options: BenchOptions, view_counts: Sequence[int] = VIEW_COUNTS) -> Iterator[Row]:
    """Rows for each capture with known cameras and a true mesh, each number of views and each chain."""
    for path in options.captures:
        train = read_capture(path, "train", options.plugins)
        test = read_capture(path, "test", options.plugins)
        truth = true_mesh(path, test)
        if truth is None or any(view.camera is None for view in train.views):
            continue
        timings: dict[str, Timing] = {}
        for count in view_counts[:1] if options.quick else view_counts:
            if count > len(train.views):
                continue
            selected = tuple(train.views[i] for i in evenly_spaced_indices(len(train.views), count))
            capture = decode_images(replace(train, views=selected))
            case: Case = {"capture": path.name, "views": count}
            for chain in initializer_chains(options, capture):
                label = ", ".join(" ".join((name, *map(str, values.values()))) for name, values in chain)
                if options.exceeds_limit(timings.get(label), 2):
                    yield Row(case, label, "ours", None, note=options.omission_note(timings[label]))
                    continue
                try:
                    scene, timings[label] = run_chain(chain, capture, options)
                except HirError as error:
                    yield Row(case, label, "ours", None, note=f"no mesh: {error}")
                    continue
                mesh = (scene.mesh.positions.detach().numpy(), scene.mesh.faces.numpy())
                comparison = compare_surfaces(mesh, truth, test.cameras)
                errors = {
                    "Chamfer, radii": comparison.chamfer,
                    "accuracy": comparison.accuracy,
                    "completeness": comparison.completeness,
                    "normals, °": comparison.normal_error_deg,
                }
                yield Row(case, label, "ours", timings[label], errors, "truth that unseen views see")


def initializer_chains(options: BenchOptions, capture: Capture) -> list[tuple[ChainStep, ...]]:
    """The suggested chain for the capture; each initializer that makes a surface, after one that measures points if it
    needs them; each of those after the suggested chain; and variants.
    """
    traits = {
        r.component.name: r.component.traits
        for r in options.plugins.components("initializer")
        if not r.missing and "reads_files" not in r.component.traits
    }
    suggested: tuple[ChainStep, ...] = tuple((name, {}) for name in options.plugins.suggest_initializers(capture))
    point_steps: list[ChainStep] = [(name, {}) for name in traits if "measures_points" in traits[name]]
    chains = [suggested]
    for name in (name for name in traits if "makes_surface" in traits[name]):
        prefixes = [(step,) for step in point_steps] if "needs_points" in traits[name] else [()]
        chains += [(*prefix, (name, values)) for prefix in prefixes for values in ({}, *VARIANTS.get(name, ()))]
        if name not in dict(suggested):
            chains += [(*suggested, *prefix, (name, {})) for prefix in prefixes]
    return [chain for i, chain in enumerate(chains) if chain and chain not in chains[:i]]


def run_chain(chain: Sequence[ChainStep], capture: Capture, options: BenchOptions) -> tuple[Scene, Timing]:
    """The chain's scene and the time of one run; vertex colours are disabled where an option exists for them.

    Raises `HirError` if the chain makes no surface.
    """
    scene: Scene | None = None
    stopwatch = Stopwatch()
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, values in chain:
            config = options.plugins.find("initializer", name).component.config
            known = getattr(config, "__dataclass_fields__", {})
            values = {**values, **({"vertex_colors": False} if "vertex_colors" in known else {})}
            initializer = options.plugins.create("initializer", name, values)
            capture, scene = initializer.initialize(capture, scene, Path(folder))
    timing = stopwatch.timing()
    if scene is None:
        raise HirError(f"{', '.join(name for name, _ in chain)} made no surface")
    return scene, timing
