"""The exact reference of silhouettes: float64 areas of the union of projected triangles, computed by shapely."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Camera
from hir_core.errors import MissingExtraError
from hir_plugins.commands.bench.inputs.bench_shapes import Faces, Positions, bench_cameras, smooth_displacements

REFERENCE_SIZE: Final = 512
DIFFERENCE_STEP: Final = 1e-5
"""Step of the central differences, in object radii; they agree with those of a step of 1e-4 within 0.03 %."""


@dataclass(frozen=True)
class AreaDerivatives:
    """Exact directional derivatives of the silhouette's area, in pixels of an image of `REFERENCE_SIZE`²."""

    displacements: list[Positions]
    values: NDArray[np.float64]
    """By camera and displacement (C, D)."""
    areas: NDArray[np.float64]
    """By camera (C,)."""


def exact_area_derivatives(positions: Positions, faces: Faces) -> AreaDerivatives:
    """Central differences of the exact area, for both cameras and two displacements."""
    displacements = smooth_displacements(positions, 2)
    cameras = bench_cameras(REFERENCE_SIZE)
    values = [
        [
            (
                silhouette_area(positions + DIFFERENCE_STEP * d, faces, camera)
                - silhouette_area(positions - DIFFERENCE_STEP * d, faces, camera)
            )
            / (2 * DIFFERENCE_STEP)
            for d in displacements
        ]
        for camera in cameras
    ]
    areas = [silhouette_area(positions, faces, camera) for camera in cameras]
    return AreaDerivatives(displacements, np.array(values), np.array(areas))


def silhouette_area(positions: Positions, faces: Faces, camera: Camera) -> float:
    """The area of the silhouette inside the frame, in pixels."""
    shapely = _import_shapely()
    pixels, _ = camera.project(positions)
    triangles = pixels[faces]
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    triangles = triangles[np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) > 1e-12]
    union = shapely.union_all(shapely.polygons(triangles))
    return float((union & shapely.box(0, 0, camera.width, camera.height)).area)


def _import_shapely() -> ModuleType:
    try:
        import shapely
    except ImportError:
        raise MissingExtraError(
            "the exact silhouettes of hir bench geometry need shapely; install it with: pip install 'hir[bench]'"
        ) from None
    module: ModuleType = shapely
    return module
