"""Charts of a mesh and where they lie in its atlas, by xatlas; numpy in, numpy out."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from hir_exporters.files.subprocess_call import Arrays, SubprocessCrashError, run_in_subprocess
from numpy.typing import NDArray

from hir_core.errors import StageError

SMALL: Final = 4000
"""Faces that xatlas cuts in less time than a process takes to start."""


def cut_and_pack(
    positions: NDArray[np.floating], faces: NDArray[np.integer], resolution: int, padding: int
) -> tuple[NDArray[np.int64], NDArray[np.float64], int]:
    """Faces (F, 3) of the atlas, its coordinates (N, 2) in 0…1, origin top-left, square; and how many charts.

    xatlas keeps Python's lock, a minute on large meshes, in which neither Ctrl-C nor a progress bar would get through:
    all but small meshes go to a process of their own.
    """
    given: dict[str, Any] = {
        "positions": _centred(positions),
        "faces": np.ascontiguousarray(faces, dtype=np.uint32),
        "resolution": resolution,
        "padding": padding,
    }
    try:
        found = (
            run_xatlas(**given)
            if len(faces) <= SMALL
            else run_in_subprocess("hir_core.mesh.uv_charts:run_xatlas", given)
        )
    except SubprocessCrashError as error:
        raise StageError(
            f"xatlas ended without an atlas ({error}); repair the mesh, or give one that has UVs"
        ) from error
    uvs = found["uvs"].astype(np.float64)
    if len(found["faces"]) != len(faces) or not np.isfinite(uvs).all():
        raise StageError("xatlas could not unwrap the mesh; repair it, or give one that has texture coordinates")
    return found["faces"].astype(np.int64), np.clip(uvs, 0, 1), int(found["charts"])


def run_xatlas(positions: Any, faces: Any, resolution: Any, padding: Any) -> Arrays:
    """xatlas on a mesh in the unit box."""
    import xatlas

    atlas = xatlas.Atlas()
    atlas.add_mesh(positions, faces)
    chart, pack = xatlas.ChartOptions(), xatlas.PackOptions()
    # half of xatlas' default cost: 2.5 times faster on 82k triangles, and fewer, better packed charts
    chart.max_cost = 1.0
    pack.resolution, pack.padding, pack.bilinear = int(resolution), int(padding), True
    atlas.generate(chart, pack)
    _, uv_faces, uvs = atlas[0]
    side = max(atlas.width, atlas.height)
    scaled = uvs.astype(np.float64) * [atlas.width / side, atlas.height / side]
    return {"faces": uv_faces, "uvs": scaled, "charts": np.asarray(int(atlas.chart_count))}


def _centred(positions: NDArray[np.floating]) -> NDArray[np.float32]:
    """In a unit box: xatlas compares areas and lengths with absolute epsilons."""
    low, high = positions.min(axis=0), positions.max(axis=0)
    return np.ascontiguousarray((positions - low) / max(float((high - low).max()), 1e-30), dtype=np.float32)
