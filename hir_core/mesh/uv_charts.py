"""Cuts a mesh into charts and packs them into an atlas, by xatlas; numpy in, numpy out."""

from __future__ import annotations

from typing import Final, SupportsInt

import numpy as np
from hir_exporters.files.subprocess_call import Arrays, SubprocessCrashError, run_in_subprocess
from numpy.typing import ArrayLike, NDArray

from hir_core.errors import StageError

FACES_IN_PROCESS: Final = 4000
"""Meshes of at most this many faces are cut in this process: that takes less time than a process takes to start."""


def cut_and_pack(
    positions: NDArray[np.floating], faces: NDArray[np.integer], resolution: int, padding: int
) -> tuple[NDArray[np.int64], NDArray[np.float64], int]:
    """Faces (F, 3) of the atlas; its coordinates (N, 2) in 0…1, origin top-left; and the number of charts.

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
            atlas = run_in_subprocess("hir_core.mesh.uv_charts:run_xatlas", arguments)
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
