"""Remeshing of a `Mesh` with its vertex colours."""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray

from hir_core.mesh.remeshing import remesh, surface_area
from hir_core.scene import Mesh, Topology


def remeshed(mesh: Mesh, triangles: int, rounds: int = 4, seed: int = 0) -> Mesh:
    """The same surface in about `triangles` well-shaped triangles; vertex colours are interpolated, texture coordinates
    are dropped.

    A mesh without area is returned as it is. `seed` is that of `remesh`.
    """
    positions = mesh.positions.detach().cpu().numpy().astype(np.float64)
    faces = mesh.faces.cpu().numpy()
    area = surface_area(positions, faces)
    if area <= 0 or triangles <= 0:
        return mesh
    # n equilateral triangles of side e cover n·√3/4·e²
    edge = math.sqrt(area / triangles * 4 / math.sqrt(3))
    x, f = remesh(positions, faces, edge, rounds, seed)
    device, dtype = mesh.positions.device, mesh.positions.dtype
    colors = None
    if mesh.vertex_colors is not None:
        colors = _nearest_colors(positions, mesh.vertex_colors, x)
    return Mesh(torch.from_numpy(x).to(device, dtype), Topology(torch.from_numpy(f).to(device)), vertex_colors=colors)


def _nearest_colors(old: NDArray[np.float64], colors: torch.Tensor, new: NDArray[np.float64]) -> torch.Tensor:
    """Inverse-distance mean of the three nearest old vertices."""
    from scipy.spatial import cKDTree

    distance, index = cKDTree(old).query(new, k=min(3, len(old)))
    distance, index = distance.reshape(len(new), -1), index.reshape(len(new), -1)
    # relative to the nearest, so that no scale of the scene underflows
    weight = distance.min(axis=1, keepdims=True) + 1e-30
    weight = weight / (distance + 1e-30)
    weight /= weight.sum(axis=1, keepdims=True)
    mixed = (colors.detach().cpu().numpy().astype(np.float64)[index] * weight[..., None]).sum(axis=1)
    return torch.from_numpy(mixed).to(colors.device, colors.dtype)
