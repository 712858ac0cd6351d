"""Silhouette renderers: value and gradient of the silhouette's area against exact polygons, at growing sizes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from hir_core.plugins.interfaces import GeometryRenderer
from hir_plugins.commands.bench.bench_options import BenchOptions
from hir_plugins.commands.bench.inputs.bench_shapes import (
    Faces,
    Positions,
    bench_cameras,
    bumpy_sphere,
    full_frame_targets,
    make_mesh,
)
from hir_plugins.commands.bench.inputs.exact_silhouettes import (
    DIFFERENCE_STEP,
    REFERENCE_SIZE,
    AreaDerivatives,
    exact_area_derivatives,
    silhouette_area,
)
from hir_plugins.commands.bench.measurement import measure
from hir_plugins.commands.bench.results.bench_result import Row, Timing

SUBDIVISIONS: Final = (4, 5, 6, 7)
"""5k, 20k, 82k and 328k triangles."""

IMAGE_SIZES: Final = (256, 512, 1024)

MAX_GROWTH: Final = 4
"""The largest expected ratio of times if the triangles or the pixels are quadrupled."""

VIEWS_PER_STEP: Final = 8
"""As in a fit."""

AreaGradients = Callable[[], tuple[list[NDArray[np.float64]], list[float]]]
"""Returns the gradient of the silhouette's area (V, 3) and the area in pixels, for each camera."""

SizeKey = tuple[str, int, int]
"""Method, subdivisions, image size."""


def geometry_rows(options: BenchOptions) -> Iterator[Row]:
    """Rows for each size: every installed differentiable renderer, the reference, and a peer."""
    components = options.plugins.components("geometry_renderer")
    names = [c.component.name for c in components if "differentiable" in c.component.traits]
    timings: dict[SizeKey, Timing] = {}
    for subdivisions in SUBDIVISIONS[:2] if options.quick else SUBDIVISIONS:
        positions, faces = bumpy_sphere(subdivisions)
        derivatives = exact_area_derivatives(positions, faces)
        triangles = len(faces)
        camera, displacement = bench_cameras(REFERENCE_SIZE)[0], derivatives.displacements[0]
        polygons = partial(silhouette_area, positions + DIFFERENCE_STEP * displacement, faces, camera)
        timing = measure(polygons, options.repeats, False)
        yield Row({"triangles": triangles, "image": "exact"}, "polygons (shapely), value alone", "reference", timing)
        for size in IMAGE_SIZES[:1] if options.quick else IMAGE_SIZES:
            case = {"triangles": triangles, "image": size}
            for name in names:
                previous = timing_of_smaller_case(timings, (name, subdivisions, size))
                if previous is not None and options.exceeds_limit(previous, MAX_GROWTH):
                    timings[name, subdivisions, size] = previous
                    yield Row(case, name, "ours", None, note=options.omission_note(previous))
                    continue
                renderer = options.plugins.create("geometry_renderer", name, {})
                errors = relative_errors(overlap_gradients(renderer, positions, faces, size), derivatives, size)
                views = VIEWS_PER_STEP if previous is None or previous.median < 0.5 else 1
                timing = measure(optimization_step(renderer, positions, faces, size, views), options.repeats)
                timings[name, subdivisions, size] = timing_per_view(timing, views)
                note = f"a view of a step of {views}"
                yield Row(case, name, "ours", timings[name, subdivisions, size], errors, note)
            previous = timing_of_smaller_case(timings, ("peer", subdivisions, size))
            if options.peers and not options.exceeds_limit(previous, MAX_GROWTH):
                from hir_plugins.commands.bench.peers.projective import SAMPLES, projective_gradients

                gradients = projective_gradients(positions, faces, bench_cameras(size))
                errors = relative_errors(gradients, derivatives, size)
                timing = timing_per_view(measure(gradients, min(options.repeats, 2), False), 2)
                timings["peer", subdivisions, size] = timing
                yield Row(case, f"Mitsuba direct_projective, {SAMPLES} samples", "peer", timing, errors)


def timing_of_smaller_case(timings: Mapping[SizeKey, Timing], key: SizeKey) -> Timing | None:
    """The timing for a quarter of the triangles, otherwise for a quarter of the pixels."""
    name, subdivisions, size = key
    return timings.get((name, subdivisions - 1, size)) or timings.get((name, subdivisions, size // 2))


def relative_errors(gradients: AreaGradients, exact: AreaDerivatives, size: int) -> dict[str, float]:
    """Root mean square errors of directional derivatives, over cameras and displacements, and of the areas."""
    by_camera, areas = gradients()
    scale = (REFERENCE_SIZE / size) ** 2
    derivatives = np.array([[(g * d).sum() * scale for d in exact.displacements] for g in by_camera])
    gradient = np.sqrt(np.mean((derivatives - exact.values) ** 2) / np.mean(exact.values**2))
    value = np.sqrt(np.mean((np.array(areas) * scale / exact.areas - 1) ** 2))
    return {"gradient error": float(gradient), "area error": float(value)}


def overlap_gradients(renderer: GeometryRenderer, positions: Positions, faces: Faces, size: int) -> AreaGradients:
    """The gradients of the interface's `overlap`, all cameras in one batch."""

    def run() -> tuple[list[NDArray[np.float64]], list[float]]:
        mesh = make_mesh(positions, faces, requires_grad=True)
        areas, _ = renderer.overlap(mesh, full_frame_targets(bench_cameras(size)))
        gradients = [torch.autograd.grad(a, mesh.positions, retain_graph=True)[0] for a in areas.unbind()]
        return [g.double().numpy() for g in gradients], areas.detach().tolist()

    return run


def optimization_step(
    renderer: GeometryRenderer, positions: Positions, faces: Faces, size: int, views: int
) -> Callable[[], object]:
    """Value and gradient of a batch of views, as in one step of a fit."""
    mesh = make_mesh(positions, faces, requires_grad=True)
    targets = full_frame_targets((bench_cameras(size) * views)[:views])

    def run() -> None:
        covered, shared = renderer.overlap(mesh, targets)
        (covered + shared).sum().backward()

    return run


def timing_per_view(timing: Timing, views: int) -> Timing:
    """The timing divided by the number of views."""
    return Timing(
        timing.minimum / views,
        timing.median / views,
        timing.maximum / views,
        timing.repeats,
        timing.cpu / views,
        timing.memory_bytes,
    )
