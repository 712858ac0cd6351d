"""Gradients of values at vertices, smoothed by a grid whose size follows the number of pixels.

A fit with fewer pixels than vertices determines no value for each vertex, and an albedo of each shows the highlights of
the photographs that it is fitted to. Here its gradient is gathered at the corners of a grid and interpolated back, so a
map changes as if it had its values there. Differences that an earlier fit found inside a cell stay.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from hir_core.optimization.linear_maps import LinearMap
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import Surface

AXIS_BITS, SIDE_BITS = 19, 3
"""Of the number of a corner: of its place along each axis, and of the side of the box that the surface faces there."""
MAX_RESOLUTION = float(1 << (AXIS_BITS - 1))
"""Cells along the longest side."""
SIZE_STEPS = 6
"""Steps of the search for the resolution: the number of cells grows with about its square, so each step takes the
square root of what is missing."""


@dataclass(frozen=True, eq=False)
class GradientGrid:
    """A grid around a surface. Two sheets of it in one cell that face different sides have corners of their own."""

    interpolation: LinearMap
    """(V, corners): trilinear weights."""
    cells: int
    """Number of cells with vertices: about as many values are independent. There are two to three times as many
    corners, but those on both sides of a sheet change together."""

    @property
    def vertices(self) -> int:
        """Number of vertices."""
        return int(self.interpolation.matrix.shape[0])

    @property
    def spacing(self) -> float:
        """Length of a cell in edges between vertices, about."""
        return math.sqrt(self.vertices / self.cells)

    def smoothed(self, gradient: Float[Tensor, "V C"]) -> Float[Tensor, "V C"]:
        """The gradient, gathered at the corners and interpolated at the vertices."""
        return self.interpolation.matrix @ (self.interpolation.transposed @ gradient.contiguous())


def gradient_grid(surface: Surface, cells: float) -> GradientGrid | None:
    """A grid with about as many cells; None where the surface has no more vertices than that."""
    if len(surface.positions) <= cells:
        return None
    low = surface.positions.amin(dim=0)
    extent = float((surface.positions - low).max())
    place = (surface.positions - low) / (extent if extent > 0 else 1.0)
    side = _facing_side(surface.normals)
    resolution = math.sqrt(max(cells, 1.0))
    for _ in range(SIZE_STEPS):
        found = len(_cell_keys(place * resolution, side).unique())
        resolution = min(max(resolution * math.sqrt(cells / found), 1.0), MAX_RESOLUTION)
    at = place * resolution
    own = _cell_keys(at, side)
    keys, index = torch.unique(_corner_keys(own), return_inverse=True)
    fraction = (at - at.floor())[:, None]
    weight = torch.where(_offsets(at.device) > 0, fraction, 1 - fraction).prod(dim=2)
    return GradientGrid(LinearMap.from_rows(index, weight, len(keys)), len(own.unique()))


def _facing_side(normals: Float[Tensor, "V 3"]) -> Int[Tensor, " V"]:
    """Number of the side of a box, 0 to 5."""
    axis = normals.abs().argmax(dim=1, keepdim=True)
    return 2 * axis[:, 0] + (normals.gather(1, axis)[:, 0] > 0)


def _cell_keys(at: Float[Tensor, "V 3"], side: Int[Tensor, " V"]) -> Int[Tensor, " V"]:
    """One number for the cell and the side of each vertex."""
    x, y, z = at.long().unbind(1)
    return ((x << AXIS_BITS | y) << AXIS_BITS | z) << SIDE_BITS | side


def _corner_keys(cell_keys: Int[Tensor, " N"]) -> Int[Tensor, "N 8"]:
    """The numbers of the corners of cells: those of the cells that start there."""
    # digits of a place leave room for one more, so the numbers of an offset can be added
    return cell_keys[:, None] + _cell_keys(_offsets(cell_keys.device), torch.zeros_like(cell_keys[:1]))


def _offsets(device: torch.device) -> Int[Tensor, "8 3"]:
    return torch.cartesian_prod(*(torch.arange(2, device=device) for _ in range(3)))
