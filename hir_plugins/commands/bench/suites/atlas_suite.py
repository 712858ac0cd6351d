"""Atlases: charts of noisy meshes by xatlas alone and from a simplified copy: time, seams, stretch, unused texels."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Final

import numpy as np
from hir_exporters.files.subprocess_call import Arrays
from numpy.typing import NDArray

from hir_core.mesh.conformal_maps import signed_areas, stretch
from hir_core.mesh.uv_charts import run_simplified, run_xatlas
from hir_plugins.commands.bench.bench_options import BenchOptions
from hir_plugins.commands.bench.inputs.bench_shapes import Faces, Positions, bumpy_sphere
from hir_plugins.commands.bench.measurement import Stopwatch
from hir_plugins.commands.bench.results.bench_result import Case, Role, Row, Timing

SUBDIVISIONS: Final = (5, 6)
"""Spheres of 20k and 82k triangles."""
NOISE_EDGES: Final = (0.0, 0.1, 0.3)
"""Standard deviation of the vertices along the normal, in edges; photo-consistency leaves about a tenth."""
RESOLUTION: Final = 1024
PADDING: Final = 5


def atlas_rows(
    options: BenchOptions, subdivisions: Sequence[int] = SUBDIVISIONS, noises: Sequence[float] = NOISE_EDGES
) -> Iterator[Row]:
    """Rows for each size, noise and method; each method runs once without a warm-up."""
    methods: tuple[tuple[str, Role, Callable[..., Arrays]], ...] = (
        ("xatlas", "reference", run_xatlas),
        ("charts of a simplified copy", "ours", run_simplified),
    )
    slowest: dict[str, Timing] = {}
    for level in subdivisions[:1] if options.quick else subdivisions:
        for noise in noises:
            positions, faces = noisy_sphere(level, noise)
            case: Case = {"triangles": len(faces), "noise, edges": noise}
            for name, role, cut in methods:
                known = slowest.get(f"{name} {noise}")
                if options.exceeds_limit(known, 6) and known is not None:
                    yield Row(case, name, role, None, note=options.omission_note(known))
                    continue
                stopwatch = Stopwatch()
                atlas = cut(positions.astype(np.float32), faces.astype(np.uint32), RESOLUTION, PADDING)
                timing = slowest[f"{name} {noise}"] = stopwatch.timing()
                yield Row(case, name, role, timing, atlas_errors(positions, faces, atlas))


def noisy_sphere(subdivisions: int, noise: float) -> tuple[Positions, Faces]:
    """A bumpy sphere in the unit box whose vertices are moved by `noise` mean edges; the same at every call."""
    positions, faces = bumpy_sphere(subdivisions)
    edge = np.linalg.norm(positions[faces[:, 0]] - positions[faces[:, 1]], axis=1).mean()
    outward = positions / np.linalg.norm(positions, axis=1, keepdims=True)
    moved = positions + noise * edge * np.random.default_rng(0).normal(size=(len(positions), 1)) * outward
    low = moved.min(axis=0)
    return (moved - low) / float((moved.max(axis=0) - low).max()), faces


def atlas_errors(positions: Positions, faces: Faces, atlas: Arrays) -> dict[str, float]:
    """Charts, length of the seams in roots of the area, stretch above 1, and share of the square without a chart."""
    uv_faces, uvs = atlas["faces"].astype(np.int64), atlas["uvs"].astype(np.float64)
    corners = positions[faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    return {
        "charts": float(atlas["charts"]),
        "seams": seam_length(positions, faces, uv_faces) / float(np.sqrt(area)),
        "stretch − 1": stretch(positions, faces, uvs, uv_faces) - 1,
        "unused": 1 - float(np.abs(signed_areas(uvs, uv_faces)).sum()),
    }


def seam_length(positions: Positions, faces: Faces, uv_faces: NDArray[np.int64]) -> float:
    """Length of the edges of two faces that have different coordinates on either side."""
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    uv_edges = np.stack([uv_faces, np.roll(uv_faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    turned = edges[:, 0] > edges[:, 1]
    edges[turned], uv_edges[turned] = edges[turned][:, ::-1], uv_edges[turned][:, ::-1]
    order = np.lexsort(edges.T)
    edges, uv_edges = edges[order], uv_edges[order]
    pair = np.flatnonzero((edges[1:] == edges[:-1]).all(axis=1))
    cut = pair[(uv_edges[pair] != uv_edges[pair + 1]).any(axis=1)]
    return float(np.linalg.norm(positions[edges[cut, 0]] - positions[edges[cut, 1]], axis=1).sum())
