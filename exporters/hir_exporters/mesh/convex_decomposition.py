"""Convex hulls for collisions: approximate convex decomposition by CoACD (Wei et al. 2022).

CoACD is native code that does not return to Python for seconds to minutes: it runs in a subprocess.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hir_exporters.asset import AssetMesh
from hir_exporters.errors import ExportError
from hir_exporters.files.subprocess_call import Arrays, SubprocessCrashError, run_in_subprocess
from hir_exporters.mesh.vertex_welding import weld

CONCAVITY: Final = 0.05
"""A part is divided until its distance to its hull is below this fraction of the object's size: CoACD's default."""

MAX_HULL_VERTICES: Final = 64
"""Limit of PhysX for hulls on a GPU."""


@dataclass(frozen=True, eq=False)
class ConvexHull:
    """A closed convex mesh in the asset's axes and unit."""

    positions: NDArray[np.float32]
    """(V, 3)."""
    faces: NDArray[np.int32]
    """(F, 3), counter-clockwise from outside."""


def convex_hulls(mesh: AssetMesh, max_hulls: int) -> tuple[ConvexHull, ...]:
    """At most `max_hulls` convex hulls that together contain nearly the whole mesh; the same mesh gives the same hulls.

    Raises `ExportError` where CoACD is not installed or gives no result.
    """
    if find_spec("coacd") is None:
        raise ExportError("collision needs coacd; install it with: pip install 'hir[collision]'")
    first, point = weld(mesh.positions)
    arguments: dict[str, ArrayLike] = {
        "positions": mesh.positions[first],
        "faces": point[mesh.faces],
        "max_hulls": max_hulls,
    }
    try:
        found = run_in_subprocess("hir_exporters.mesh.convex_decomposition:decompose", arguments)
    except SubprocessCrashError as error:
        raise ExportError(f"CoACD could not divide the mesh into convex hulls ({error}); set collision=none") from error
    positions = np.split(found["positions"], np.cumsum(found["vertices"])[:-1])
    faces = np.split(found["faces"], np.cumsum(found["triangles"])[:-1])
    return tuple(ConvexHull(p, f) for p, f in zip(positions, faces, strict=True))


def decompose(positions: NDArray[np.float32], faces: NDArray[np.int64], max_hulls: NDArray[np.int64]) -> Arrays:
    """The hulls of a mesh one after the other: `positions`, `faces`, and the `vertices` and `triangles` of each."""
    import coacd

    coacd.set_log_level("error")
    parts = coacd.run_coacd(
        coacd.Mesh(positions.astype(np.float64), faces.astype(np.int32)),
        threshold=CONCAVITY,
        max_convex_hull=int(max_hulls),
        decimate=True,
        max_ch_vertex=MAX_HULL_VERTICES,
        seed=0,
    )
    hulls = [(np.asarray(p, np.float32), _outwards(np.asarray(p), np.asarray(f, np.int32))) for p, f in parts]
    return {
        "positions": np.concatenate([p for p, _ in hulls]),
        "faces": np.concatenate([f for _, f in hulls]),
        "vertices": np.array([len(p) for p, _ in hulls]),
        "triangles": np.array([len(f) for _, f in hulls]),
    }


def _outwards(positions: NDArray[np.floating], faces: NDArray[np.int32]) -> NDArray[np.int32]:
    a, b, c = (positions[faces[:, k]] - positions.mean(axis=0) for k in range(3))
    volume = float((a * np.cross(b, c)).sum())
    return faces if volume > 0 else faces[:, ::-1]
