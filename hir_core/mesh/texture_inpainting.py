"""Inpainting of unobserved texels: harmonic interpolation along the surface, across the seams of the atlas."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy.typing import NDArray
from torch import Tensor

from hir_core.mesh.texel_rasterization import TexelSurface, interpolate, texel_surface
from hir_core.scene import Mesh

_RELAXATIONS = 40
"""Averaging steps after the harmonic solution: they smooth the border between observed and inpainted texels."""


def fill_unobserved(
    texture: Float[Tensor, "H W C"],
    mesh: Mesh,
    observed: Bool[Tensor, "H W"],
    surface: TexelSurface | None = None,
) -> Float[Tensor, "H W C"]:
    """Replaces covered texels that are not `observed`; the others stay. Not differentiable.

    Vertices near observed texels get their means, other vertices the harmonic interpolation over the edges of the
    mesh, which crosses seams. A component without any observation gets the median of all. Values stay in the range of
    the observed ones. Without any observation the texture is returned unchanged.
    """
    surface = surface or texel_surface(mesh, (texture.shape[0], texture.shape[1]))
    is_observed = observed[surface.covered]
    if bool(is_observed.all()) or not bool(is_observed.any()):
        return texture
    values = texture[surface.covered].detach().double()
    weights = surface.barycentric.double()
    vertices = harmonic_vertices(
        mesh.faces.cpu().numpy(),
        len(mesh.positions),
        mesh.faces[surface.face[is_observed]].cpu().numpy(),
        weights[is_observed].cpu().numpy(),
        values[is_observed].cpu().numpy(),
    )
    interpolated = interpolate(torch.from_numpy(vertices).to(values.device), mesh.faces, surface.face, weights)
    filled = texture.clone()
    filled[surface.covered] = torch.where(is_observed[:, None], values, interpolated).to(texture.dtype)
    filled = _relax(filled, surface.covered, surface.covered & ~observed)
    return torch.where(observed[..., None] | ~surface.covered[..., None], texture, filled)


def harmonic_vertices(
    faces: NDArray[np.int64],
    count: int,
    corners: NDArray[np.int64],
    weights: NDArray[np.float64],
    values: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(V, C): means of samples (N, C) at their corners (N, 3), harmonically continued to the other vertices."""
    from scipy import sparse
    from scipy.sparse.csgraph import connected_components
    from scipy.sparse.linalg import spsolve

    flat = corners.ravel()
    total = np.bincount(flat, weights.ravel(), count)
    result = np.zeros((count, values.shape[1]))
    for channel in range(values.shape[1]):
        result[:, channel] = np.bincount(flat, (weights * values[:, None, channel]).ravel(), count)
    known = total > 1e-9
    result[known] /= total[known, None]

    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = np.concatenate([ends, ends[:, ::-1]])
    ends = ends[ends[:, 0] != ends[:, 1]]
    adjacency = sparse.csr_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    adjacency.data[:] = 1
    _, component = connected_components(adjacency, directed=False)
    reached = np.zeros(component.max() + 1, dtype=bool)
    reached[component[known]] = True
    isolated = ~reached[component]
    result[isolated] = np.median(values, axis=0)
    unknown = np.flatnonzero(~known & ~isolated)
    if len(unknown):
        rows = adjacency[unknown]
        degree = sparse.diags(np.asarray(rows.sum(axis=1)).ravel())
        system = (degree - rows[:, unknown]).tocsc()
        boundary = rows[:, known] @ result[known]
        result[unknown] = spsolve(system, boundary).reshape(len(unknown), -1)
    low, high = values.min(axis=0), values.max(axis=0)
    return np.clip(result, low, high)  # the maximum principle holds but for rounding


def _relax(texture: Tensor, covered: Tensor, free: Tensor) -> Tensor:
    """Averages free texels with their four covered neighbours, within charts.

    Only free texels are computed: most textures have few.
    """
    height, width, channels = texture.shape
    values = torch.nn.functional.pad(texture * covered[..., None], (0, 0, 1, 1, 1, 1)).reshape(-1, channels)
    known = torch.nn.functional.pad(covered, (1, 1, 1, 1)).reshape(-1)
    texels = torch.nn.functional.pad(free, (1, 1, 1, 1)).reshape(-1).nonzero()[:, 0]
    steps = (-1, 1, -(width + 2), width + 2)
    count = sum(known[texels + step].to(values.dtype) for step in steps)
    assert isinstance(count, Tensor)
    texels, count = texels[count > 0], count[count > 0][:, None]
    near = [texels + step for step in steps]
    for _ in range(_RELAXATIONS):
        total = values.index_select(0, near[0])
        for each in near[1:]:
            total += values.index_select(0, each)
        values[texels] = total / count
    relaxed = values.reshape(height + 2, width + 2, channels)[1:-1, 1:-1]
    return torch.where(covered[..., None], relaxed, texture)
