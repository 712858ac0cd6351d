"""Silhouette renderers: value and gradient of a silhouette's area against exact polygons, as meshes and images grow."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray

from hir_core.plugins.interfaces import GeometryRenderer
from hir_plugins.commands.bench.bench_plan import Plan
from hir_plugins.commands.bench.inputs.bench_shapes import (
    Faces,
    Positions,
    bumpy_sphere,
    cameras,
    full_targets,
    mesh_of,
)
from hir_plugins.commands.bench.inputs.exact_silhouettes import REFERENCE_SIZE, STEP, Slopes, area, exact_slopes
from hir_plugins.commands.bench.measurement import measure
from hir_plugins.commands.bench.results.bench_result import Row, Timing

LEVELS, SIZES = (4, 5, 6, 7), (256, 512, 1024)
"""5k, 20k, 82k and 328k triangles."""

GROWTH = 4
"""Times as long as for a quarter of the triangles or pixels, at most, by the growth of either."""

BATCH = 8
"""Views of one step, as a fit takes them."""

Gradients = Callable[[], tuple[list[NDArray[np.float64]], list[float]]]
"""Gradient of the area (V, 3), and the area in pixels, of each camera."""


def geometry(plan: Plan) -> Iterator[Row]:
    """Rows for each size: every differentiable renderer that is installed, the reference, and a peer."""
    components = plan.plugins.components("geometry_renderer")
    names = [c.component.name for c in components if "differentiable" in c.component.traits]
    known: dict[tuple[str, int, int], Timing] = {}
    for level in LEVELS[:2] if plan.quick else LEVELS:
        positions, faces = bumpy_sphere(level)
        slopes = exact_slopes(positions, faces)
        triangles = len(faces)
        view, direction = cameras(REFERENCE_SIZE)[0], slopes.directions[0]
        timing = measure(partial(area, positions + STEP * direction, faces, view), plan.repeats, False)
        yield Row({"triangles": triangles, "image": "exact"}, "polygons (shapely), value alone", "reference", timing)
        for size in SIZES[:1] if plan.quick else SIZES:
            case = {"triangles": triangles, "image": size}
            for name in names:
                before = smaller(known, name, level, size)
                if plan.too_slow(before, GROWTH):
                    assert before is not None
                    known[name, level, size] = before
                    yield Row(case, name, "ours", None, note=plan.left_out(before))
                    continue
                renderer = plan.plugins.create("geometry_renderer", name, {})
                errors = judged(by_overlap(renderer, positions, faces, size), slopes, size)
                batch = BATCH if before is None or before.median < 0.5 else 1
                step = measure(one_step(renderer, positions, faces, size, batch), plan.repeats)
                known[name, level, size] = per_view(step, batch)
                yield Row(case, name, "ours", known[name, level, size], errors, f"a view of a step of {batch}")
            if plan.peers and not plan.too_slow(smaller(known, "peer", level, size), GROWTH):
                from hir_plugins.commands.bench.peers.projective import SAMPLES, projective_gradients

                found = projective_gradients(positions, faces, cameras(size))
                errors = judged(found, slopes, size)
                timing = known["peer", level, size] = per_view(measure(found, min(plan.repeats, 2), False), 2)
                yield Row(case, f"Mitsuba direct_projective, {SAMPLES} samples", "peer", timing, errors)


def smaller(known: Mapping[tuple[str, int, int], Timing], name: str, level: int, size: int) -> Timing | None:
    """What a renderer took for a quarter of the triangles, else for a quarter of the pixels."""
    return known.get((name, level - 1, size)) or known.get((name, level, size // 2))


def judged(gradients: Gradients, slopes: Slopes, size: int) -> dict[str, float]:
    """Root mean square error of directional derivatives over cameras and directions, and of the areas; relative."""
    found, areas = gradients()
    scale = (REFERENCE_SIZE / size) ** 2
    derivatives = np.array([[(g * d).sum() * scale for d in slopes.directions] for g in found])
    gradient = np.sqrt(np.mean((derivatives - slopes.values) ** 2) / np.mean(slopes.values**2))
    value = np.sqrt(np.mean((np.array(areas) * scale / slopes.areas - 1) ** 2))
    return {"gradient error": float(gradient), "area error": float(value)}


def by_overlap(renderer: GeometryRenderer, positions: Positions, faces: Faces, size: int) -> Gradients:
    """By the interface's `overlap`, all cameras in one batch."""

    def run() -> tuple[list[NDArray[np.float64]], list[float]]:
        mesh = mesh_of(positions, faces, grad=True)
        areas, _ = renderer.overlap(mesh, full_targets(cameras(size)))
        grads = [torch.autograd.grad(a, mesh.positions, retain_graph=True)[0] for a in areas.unbind()]
        return [g.double().numpy() for g in grads], areas.detach().tolist()

    return run


def one_step(
    renderer: GeometryRenderer, positions: Positions, faces: Faces, size: int, batch: int
) -> Callable[[], object]:
    """Value and gradient of a batch of views, as a step of the fit does it."""
    mesh = mesh_of(positions, faces, grad=True)
    targets = full_targets((cameras(size) * batch)[:batch])

    def run() -> None:
        covered, shared = renderer.overlap(mesh, targets)
        (covered + shared).sum().backward()

    return run


def per_view(timing: Timing, views: int) -> Timing:
    """The share of one view."""
    return Timing(
        timing.minimum / views,
        timing.median / views,
        timing.maximum / views,
        timing.repeats,
        timing.cpu / views,
        timing.memory_bytes,
    )
