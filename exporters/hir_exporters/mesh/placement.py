"""Scale and pivot of an asset: its size in metres, and the point of it that is the origin."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import Asset
from hir_exporters.errors import InputError

Pivot = Literal["source", "base", "centre"]


def placement(asset: Asset, scale: float | None, height: float | None, pivot: Pivot) -> NDArray[np.float64]:
    """The matrix (4, 4) of a uniform scale and a translation that gives the asset its size and pivot.

    `height` is the extent along +Y in metres. The origin becomes the middle of the bounding box (`centre`) or of its
    lower face (`base`); `source` keeps it, and scales about it. Raises `InputError` for a size that is not positive,
    for both sizes, and for the height of a flat mesh.
    """
    if scale is not None and height is not None:
        raise InputError("scale and height are both given; give one of them")
    for name, value in (("scale", scale), ("height", height)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise InputError(f"{name} is {value:g}; it must be a positive number")
    low, high = (
        asset.mesh.positions.astype(np.float64).min(axis=0),
        asset.mesh.positions.astype(np.float64).max(axis=0),
    )
    if height is not None:
        if high[1] <= low[1]:
            raise InputError("the mesh has no extent along +Y, so that no scale gives it a height; use a scale instead")
        scale = height / float(high[1] - low[1])
    factor = 1.0 if scale is None else scale
    origin = {"source": np.zeros(3), "centre": (low + high) / 2, "base": (low + high) / 2}[pivot].copy()
    if pivot == "base":
        origin[1] = low[1]
    matrix = np.diag([factor, factor, factor, 1.0])
    matrix[:3, 3] = -factor * origin
    return matrix


def placed_asset(asset: Asset, matrix: NDArray[np.float64]) -> Asset:
    """The asset after `placement`; its provenance says which matrix was applied. The identity changes nothing."""
    if np.array_equal(matrix, np.eye(4)):
        return asset
    positions = asset.mesh.positions.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    provenance = {**asset.provenance, "placement": matrix.tolist()}
    mesh, environment = replace(asset.mesh, positions=positions.astype(np.float32)), asset.environment
    if environment is not None and environment.lamp is not None:
        environment = replace(environment, lamp=environment.lamp.scaled(float(matrix[0, 0])))
    return replace(asset, mesh=mesh, environment=environment, provenance=provenance)
