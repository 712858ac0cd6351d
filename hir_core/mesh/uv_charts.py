"""Cuts a mesh into charts and packs them into an atlas, by xatlas; numpy in, numpy out.

The time of xatlas grows faster than the number of triangles, and noise is cut into many small charts. Large meshes are
therefore charted on a denoised and simplified copy. The charts are transferred and mapped conformally; xatlas packs
them. A chart whose map overlaps or stretches is cut by xatlas itself.
"""

from __future__ import annotations

import math
from typing import Any, Final, SupportsInt

import numpy as np
from hir_exporters.files.subprocess_call import Arrays, SubprocessCrashError, run_in_subprocess
from numpy.typing import ArrayLike, NDArray

from hir_core.errors import StageError
from hir_core.mesh.chart_segmentation import denoised, transferred_labels
from hir_core.mesh.conformal_maps import conformal_map, is_injective, signed_areas, stretch
from hir_core.mesh.mesh_validity import component_of_vertices
from hir_core.mesh.remeshing import surface_area

FACES_IN_PROCESS: Final = 4000
"""Meshes of at most this many faces are cut in this process: that takes less time than a process takes to start."""

SIMPLIFIED_FROM: Final = 20_000
"""Meshes of more faces are charted on a simplified copy; below, xatlas takes a few seconds."""

COARSE_FACES: Final = 10_000
"""Faces of the simplified copy."""

_COARSE_PACKING_SIDE = 64
"""Charts whose packing is not used are packed on few texels."""

_CHART_SPACING = 4.0
"""Between charts that are not packed yet: no chart of a mesh in the unit box is as wide."""

MAX_STRETCH: Final = 1.25
"""Root mean square stretch (Sander et al. 2001) above which xatlas cuts a chart further."""


def cut_and_pack(
    positions: NDArray[np.floating], faces: NDArray[np.integer], resolution: int, padding: int
) -> tuple[NDArray[np.int64], NDArray[np.float64], int]:
    """Faces (F, 3) of the atlas; its coordinates (N, 2) in 0…1, origin top-left; and the number of charts.

    With more than `SIMPLIFIED_FROM` faces the charts come from a simplified copy of the mesh.

    xatlas holds Python's global lock, for a minute on large meshes, which blocks Ctrl-C and the progress bar. All but
    small meshes are therefore cut in a process of their own. `StageError` where xatlas fails.
    """
    mesh = _in_unit_box(positions), np.ascontiguousarray(faces, dtype=np.uint32)
    try:
        if len(faces) <= FACES_IN_PROCESS:
            atlas = run_xatlas(*mesh, resolution, padding)
        else:
            arguments: dict[str, ArrayLike] = {
                "positions": mesh[0],
                "faces": mesh[1],
                "resolution": resolution,
                "padding": padding,
            }
            function = "run_simplified" if len(faces) > SIMPLIFIED_FROM else "run_xatlas"
            atlas = run_in_subprocess(f"hir_core.mesh.uv_charts:{function}", arguments)
    except SubprocessCrashError as error:
        raise StageError(
            f"xatlas ended without an atlas ({error}); repair the mesh, or use one with texture coordinates"
        ) from error
    uvs = atlas["uvs"].astype(np.float64)
    if len(atlas["faces"]) != len(faces) or not np.isfinite(uvs).all():
        raise StageError("xatlas could not unwrap the mesh; repair it, or use one with texture coordinates")
    return atlas["faces"].astype(np.int64), np.clip(uvs, 0, 1), int(atlas["charts"])


def run_xatlas(
    positions: NDArray[np.float32], faces: NDArray[np.uint32], resolution: SupportsInt, padding: SupportsInt
) -> Arrays:
    """Runs xatlas on a mesh in the unit box: `faces`, `uvs` and the number of `charts`."""
    import xatlas

    atlas = xatlas.Atlas()
    atlas.add_mesh(positions, faces)
    return _generated(atlas, resolution, padding)


def run_simplified(
    positions: NDArray[np.float32], faces: NDArray[np.uint32], resolution: SupportsInt, padding: SupportsInt
) -> Arrays:
    """As `run_xatlas`, with charts of a denoised and simplified copy of the mesh."""
    import xatlas

    triangles = faces.astype(np.int64)
    smooth = denoised(positions.astype(np.float64), triangles)
    coarse = _simplified(smooth, triangles, COARSE_FACES)
    charted = run_xatlas(_in_unit_box(coarse[0]), coarse[1].astype(np.uint32), _COARSE_PACKING_SIDE, 1)
    labels = transferred_labels(smooth, triangles, coarse, _islands(charted["faces"].astype(np.int64)))
    uv_faces, uvs = _mapped(smooth, triangles, labels)
    atlas = xatlas.Atlas()
    atlas.add_uv_mesh(np.ascontiguousarray(uvs, np.float32), np.ascontiguousarray(uv_faces, np.uint32))
    return _generated(atlas, resolution, padding)


def _mapped(
    positions: NDArray[np.float64], faces: NDArray[np.int64], labels: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Faces (F, 3) and coordinates (N, 2) of unpacked charts with the surface's area, one for each label."""
    order = np.argsort(labels, kind="stable")
    # on a square grid offsets stay small: xatlas reads float32
    columns = math.isqrt(int(labels.max(initial=0))) + 1
    uv_faces = np.zeros_like(faces)
    parts: list[NDArray[np.float64]] = []
    total = 0
    for members in np.split(order, np.flatnonzero(np.diff(labels[order])) + 1):
        used, local = np.unique(faces[members], return_inverse=True)
        chart, own = local.reshape(-1, 3).astype(np.int64), positions[used]
        if surface_area(own, chart) == 0:
            uvs = np.zeros((len(own), 2))  # a piece without area is one point
        elif not (is_injective(uvs := conformal_map(own, chart), chart) and stretch(own, chart, uvs) < MAX_STRETCH):
            cut = run_xatlas(_in_unit_box(own), chart.astype(np.uint32), _COARSE_PACKING_SIDE, 1)
            chart, uvs = cut["faces"].astype(np.int64), cut["uvs"] * _scale_to_area(own, chart, cut)
        uv_faces[members] = total + chart
        parts.append(uvs + _CHART_SPACING * np.array(divmod(len(parts), columns)))
        total += len(uvs)
    return uv_faces, np.concatenate(parts)


def _scale_to_area(positions: NDArray[np.float64], faces: NDArray[np.int64], cut: Arrays) -> float:
    """The factor by which coordinates of `cut` have the surface's area."""
    surface = surface_area(positions, faces)
    mapped = np.abs(signed_areas(cut["uvs"].astype(np.float64), cut["faces"].astype(np.int64))).sum()
    return float(np.sqrt(surface / mapped)) if mapped > 0 else 1.0


def _simplified(
    positions: NDArray[np.float64], faces: NDArray[np.int64], count: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The mesh simplified to about `count` faces by quadric collapses (Garland & Heckbert 1997, open3d)."""
    import open3d

    mesh = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(positions), open3d.utility.Vector3iVector(faces.astype(np.int32))
    )
    mesh = mesh.simplify_quadric_decimation(count)
    return np.asarray(mesh.vertices), np.asarray(mesh.triangles).astype(np.int64)


def _islands(uv_faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """The chart (F,) of each face of an atlas: the connected component of its coordinates."""
    return component_of_vertices(uv_faces)[1][uv_faces[:, 0]]


def _generated(atlas: Any, resolution: SupportsInt, padding: SupportsInt) -> Arrays:
    """Cuts what has no coordinates yet, and packs."""
    import xatlas

    chart, pack = xatlas.ChartOptions(), xatlas.PackOptions()
    # half of xatlas' default cost: 2.5 times faster on 82k triangles, and fewer, better packed charts
    chart.max_cost = 1.0
    pack.resolution, pack.padding, pack.bilinear = int(resolution), int(padding), True
    atlas.generate(chart, pack)
    _, uv_faces, uvs = atlas[0]
    side = max(atlas.width, atlas.height)
    scaled = uvs.astype(np.float64) * [atlas.width / side, atlas.height / side]
    return {"faces": uv_faces, "uvs": scaled, "charts": np.asarray(int(atlas.chart_count))}


def _in_unit_box(positions: NDArray[np.floating]) -> NDArray[np.float32]:
    """The positions scaled into the unit box, because xatlas compares areas and lengths with absolute epsilons."""
    low, high = positions.min(axis=0), positions.max(axis=0)
    return np.ascontiguousarray((positions - low) / max(float((high - low).max()), 1e-30), dtype=np.float32)
