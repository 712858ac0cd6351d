"""Lists of the triangles that reach each tile of an image, and their soft coverage there."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

FULL_TOLERANCE = 1e-6
"""A tile counts as full only where 1 − S is proven to be below this."""

PAIRS_PER_CHUNK = 1 << 20
"""Pairs of pixel and triangle that are evaluated at once: bounds the memory."""


@dataclass(frozen=True)
class Kernel:
    """The sigmoid, in pixels."""

    sigma: float
    """Pixels squared."""
    cutoff: float
    tile: int

    @property
    def reach(self) -> float:
        """Distance in pixels at which a triangle's own coverage falls to `cutoff`."""
        return math.sqrt(self.sigma * math.log(1 / self.cutoff - 1))


@dataclass(frozen=True, eq=False)
class Tiles:
    """Tiles that must be evaluated, and their pairs with the triangles in reach, sorted by tile."""

    height: int
    width: int
    size: int
    open: Int[Tensor, " T"]
    """Number of each tile that must be evaluated, row by row."""
    full: Int[Tensor, " U"]
    """Tiles that are proven to be 1, or set to 1 outside of the band."""
    pair_tile: Int[Tensor, " P"]
    """Index into `open`."""
    pair_triangle: Int[Tensor, " P"]

    @property
    def columns(self) -> int:
        return -(-self.width // self.size)

    def centers(self, tile: Int[Tensor, " N"], dtype: torch.dtype) -> Float[Tensor, "N S 2"]:
        """Pixel centres of tiles."""
        step = torch.arange(self.size, device=tile.device, dtype=dtype) + 0.5
        dy, dx = torch.meshgrid(step, step, indexing="ij")
        corner = torch.stack([tile % self.columns, tile // self.columns], dim=1).to(dtype) * self.size
        return corner[:, None] + torch.stack([dx.reshape(-1), dy.reshape(-1)], dim=1)

    def to_image(self, values: Float[Tensor, "T S"], full: float) -> Float[Tensor, "H W"]:
        """Assembles the tiles into an image."""
        rows = -(-self.height // self.size)
        canvas = values.new_zeros((rows * self.columns, self.size * self.size))
        canvas[self.full] = full
        canvas[self.open] = values
        image = canvas.reshape(rows, self.columns, self.size, self.size).transpose(1, 2)
        return image.reshape(rows * self.size, -1)[: self.height, : self.width]

    def from_image(self, image: Float[Tensor, "H W"]) -> Float[Tensor, "T S"]:
        """Cuts the open tiles out of an image; beyond its border they are 0."""
        rows = -(-self.height // self.size)
        padded = torch.nn.functional.pad(
            image, (0, self.columns * self.size - self.width, 0, rows * self.size - self.height)
        )
        tiles = padded.reshape(rows, self.size, self.columns, self.size).transpose(1, 2)
        return tiles.reshape(rows * self.columns, -1)[self.open]


def gather_tiles(
    triangles: Float[Tensor, "F 3 2"], height: int, width: int, kernel: Kernel, band: Bool[Tensor, "H W"] | None = None
) -> Tiles:
    """Finds the pairs; tiles that no triangle reaches are 0 and not listed.

    `1 − S ≤ Π (1 − D)` over any part of the triangles, and D is at least its value at the tile's farthest point from
    the triangle's nearest corner: where these lower bounds multiply to less than `FULL_TOLERANCE`, the tile is full.
    """
    size, device = kernel.tile, triangles.device
    columns, rows = -(-width // size), -(-height // size)
    finite = torch.isfinite(triangles).all(dim=2).all(dim=1)
    low = ((triangles.amin(1) - kernel.reach) / size).floor()
    high = ((triangles.amax(1) + kernel.reach) / size).floor() + 1
    limit = torch.tensor([columns, rows], device=device, dtype=triangles.dtype)
    low = torch.minimum(low.nan_to_num().clamp_min(0), limit).long()
    high = torch.minimum(high.nan_to_num().clamp_min(0), limit).long()
    span = (high - low).clamp_min(0) * finite[:, None]
    amount = span.prod(dim=1)
    pair_triangles, pair_tiles = [], []
    fullness = torch.zeros(columns * rows, dtype=torch.float64, device=device)
    for part in _parts(amount, PAIRS_PER_CHUNK):
        triangle = torch.repeat_interleave(part, amount[part])
        offset = torch.arange(len(triangle), device=device) - (
            torch.cumsum(amount[part], 0) - amount[part]
        ).repeat_interleave(amount[part])
        across = span[triangle, 0]
        tile = (low[triangle, 1] + offset // across) * columns + low[triangle, 0] + offset % across
        middle = torch.stack([tile % columns, tile // columns], dim=1).to(triangles.dtype).add(0.5).mul(size)
        corners = triangles[triangle]
        distance2, inside, _, _ = nearest_edge(middle[:, None], corners)
        radius = size / math.sqrt(2)
        near = inside[:, 0] | (distance2[:, 0] <= (kernel.reach + radius) ** 2)
        triangle, tile, middle, corners = triangle[near], tile[near], middle[near], corners[near]
        # farthest pixel of the tile from each corner; the edge is never farther than the nearest corner
        farthest = ((corners - middle[:, None]).norm(dim=2).amin(dim=1) + radius).square()
        bound = torch.where(farthest <= kernel.reach**2, torch.nn.functional.softplus(-farthest / kernel.sigma), 0.0)
        # deep inside a large triangle: at least this far from its edges
        deep = (distance2[near, 0].sqrt() - radius).clamp_min(0).square() / kernel.sigma
        inner = inside[near, 0] & (distance2[near, 0] > radius**2)
        bound = torch.where(inner, torch.nn.functional.softplus(deep), bound)
        fullness.index_add_(0, tile, bound.double())
        pair_triangles.append(triangle)
        pair_tiles.append(tile)
    empty = torch.zeros(0, dtype=torch.int64, device=device)
    pair_triangle = torch.cat(pair_triangles) if pair_triangles else empty
    pair_tile = torch.cat(pair_tiles) if pair_tiles else empty
    is_full = fullness > -math.log(FULL_TOLERANCE)
    if band is not None:
        is_full |= _away_from_band(band, size, rows, columns, pair_tile)
    kept = ~is_full[pair_tile]
    pair_triangle, pair_tile = pair_triangle[kept], pair_tile[kept]
    order = torch.argsort(pair_tile, stable=True)
    opened, index = torch.unique(pair_tile[order], return_inverse=True)
    return Tiles(height, width, size, opened, is_full.nonzero().reshape(-1), index, pair_triangle[order])


def _away_from_band(band: Tensor, size: int, rows: int, columns: int, reached: Tensor) -> Bool[Tensor, " N"]:
    """Tiles without a pixel of the band that lie inside: those that some triangle reaches (outside ones are 0 to
    1e-4).
    """
    padded = torch.nn.functional.pad(band, (0, columns * size - band.shape[1], 0, rows * size - band.shape[0]))
    touched = padded.reshape(rows, size, columns, size).transpose(1, 2).reshape(rows * columns, -1).any(dim=1)
    covered = torch.zeros_like(touched)
    covered[reached] = True
    return covered & ~touched


def accumulate(triangles: Float[Tensor, "F 3 2"], tiles: Tiles, kernel: Kernel) -> Float[Tensor, "T S"]:
    """`log Π (1 − D)` at each pixel of the open tiles."""
    total = triangles.new_zeros((len(tiles.open), tiles.size**2))
    for tile, triangle in _pairs(tiles):
        distance2, inside, _, _ = nearest_edge(tiles.centers(tiles.open[tile], triangles.dtype), triangles[triangle])
        signed = torch.where(inside, distance2, -distance2) / kernel.sigma
        counts = inside | (distance2 <= kernel.reach**2)
        total.index_add_(0, tile, torch.where(counts, -torch.nn.functional.softplus(signed), 0.0))
    return total


def gradient(
    triangles: Float[Tensor, "F 3 2"], tiles: Tiles, kernel: Kernel, weight: Float[Tensor, "T S"]
) -> Float[Tensor, "F 3 2"]:
    """Derivative of `Σ weight · log Π (1 − D)`. The nearest point of an edge slides along it without changing d²."""
    result = torch.zeros_like(triangles)
    for tile, triangle in _pairs(tiles):
        centers = tiles.centers(tiles.open[tile], triangles.dtype)
        corners = triangles[triangle]
        distance2, inside, edge, along = nearest_edge(centers, corners)
        sign = torch.where(inside, 1.0, -1.0)
        counts = inside | (distance2 <= kernel.reach**2)
        slope = -torch.sigmoid(sign * distance2 / kernel.sigma) * sign / kernel.sigma
        scale = torch.where(counts, slope * weight[tile], 0.0)
        for k in range(3):
            here = edge == k
            a, b = corners[:, None, k], corners[:, None, (k + 1) % 3]
            t = along[..., None]
            pull = (-2 * scale * here)[..., None] * (centers - (a + t * (b - a)))
            result[:, k].index_add_(0, triangle, (pull * (1 - t)).sum(dim=1))
            result[:, (k + 1) % 3].index_add_(0, triangle, (pull * t).sum(dim=1))
    return result


def nearest_edge(
    points: Float[Tensor, "P S 2"], corners: Float[Tensor, "P 3 2"]
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Squared distance to a triangle's boundary, whether inside, the nearest edge and how far along it (all P S)."""
    distances, fractions, sides = [], [], []
    for k in range(3):
        a, b = corners[:, None, k], corners[:, None, (k + 1) % 3]
        edge = b - a
        offset = points - a
        length2 = edge.square().sum(-1)
        t = ((offset * edge).sum(-1) / length2.clamp_min(torch.finfo(points.dtype).tiny)).clamp(0, 1)
        distances.append((offset - t[..., None] * edge).square().sum(-1))
        fractions.append(t)
        sides.append(edge[..., 0] * offset[..., 1] - edge[..., 1] * offset[..., 0])
    side = torch.stack(sides)
    inside = (side > 0).all(0) | (side < 0).all(0)
    distance2, edge_index = torch.stack(distances).min(dim=0)
    return distance2, inside, edge_index, torch.stack(fractions).gather(0, edge_index[None])[0]


def _pairs(tiles: Tiles) -> Iterator[tuple[Tensor, Tensor]]:
    step = max(1, PAIRS_PER_CHUNK // tiles.size**2)
    for start in range(0, len(tiles.pair_tile), step):
        yield tiles.pair_tile[start : start + step], tiles.pair_triangle[start : start + step]


def _parts(amount: Int[Tensor, " F"], limit: int) -> Iterator[Int[Tensor, " N"]]:
    """Triangles in runs of at most `limit` pairs (or one triangle, if it alone has more)."""
    used = amount.nonzero().reshape(-1)
    total = torch.cumsum(amount[used], 0)
    start = 0
    while start < len(used):
        base = int(total[start - 1]) if start else 0
        stop = max(start + 1, int(torch.searchsorted(total, base + limit, right=True)))
        yield used[start:stop]
        start = stop
