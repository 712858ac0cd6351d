"""Constant linear maps for automatic differentiation, and sparse matrices whose values change but not their pattern.

torch multiplies a sparse matrix of coordinates with three columns twenty times slower than a compressed one, and makes
the transpose that a gradient needs anew at every step.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cache, cached_property
from typing import final

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

ROWS_AT_ONCE = 64
"""Of a large dense matrix, in each of the products that are added."""
LARGE_MATRIX = 1 << 21
"""Entries of a matrix that is larger than the cache of a processor."""


@dataclass(frozen=True, eq=False)
class SparsityPattern:
    """Positions of the entries of a sparse matrix: the same number in each row, in `columns` (rows, entries)."""

    columns: Int[Tensor, "R N"]
    width: int
    """Number of columns of the matrix."""

    def matrix(self, values: Float[Tensor, "R N"]) -> Tensor:
        """The matrix as a compressed sparse row tensor."""
        return compressed(self._start, self._flat, values.reshape(-1), (len(self.columns), self.width))

    def transposed(self, values: Float[Tensor, "R N"]) -> Tensor:
        """Its transpose as a compressed sparse row tensor."""
        order, start, owner = self._transpose
        # `index_select` is four times faster here than indexing
        reordered = values.reshape(-1).index_select(0, order)
        return compressed(start, owner, reordered, (self.width, len(self.columns)))

    @cached_property
    def _flat(self) -> Tensor:
        return self.columns.reshape(-1).int()

    @cached_property
    def _start(self) -> Tensor:
        rows, entries = self.columns.shape
        return torch.arange(rows + 1, dtype=torch.int32, device=self.columns.device) * entries

    @cached_property
    def _transpose(self) -> tuple[Tensor, Tensor, Tensor]:
        # computed once, because a new lobe width changes only the values; scipy's counting sort is linear
        from scipy.sparse import csr_matrix

        positions = np.arange(len(self._flat), dtype=np.int32)
        shape = (len(self.columns), self.width)
        by_row = csr_matrix((positions, self._flat.cpu().numpy(), self._start.cpu().numpy()), shape)
        by_column = by_row.tocsc()
        parts = by_column.data, by_column.indptr, by_column.indices
        order, start, owner = (torch.from_numpy(p.astype(np.int32, copy=False)).to(self.columns.device) for p in parts)
        return order, start, owner


@final
class LinearMap:
    """A constant matrix, dense or sparse, and a copy of its transpose, so that value and gradient are equally fast."""

    def __init__(self, matrix: Tensor, transposed: Tensor | None = None) -> None:
        """Without `transposed` it is made where it is first needed: a map that is only evaluated needs none."""
        self.matrix = matrix
        self._transposed = transposed

    @property
    def is_dense(self) -> bool:
        """Whether all entries are stored."""
        return self.matrix.layout == torch.strided

    @property
    def transposed(self) -> Tensor:
        """A copy of the transpose."""
        if self._transposed is None:
            self._transposed = _transposed(self.matrix)
        return self._transposed

    @classmethod
    def from_rows(cls, columns: Int[Tensor, "R N"], values: Float[Tensor, "R N"], width: int) -> LinearMap:
        """A matrix with the same number of entries in every row."""
        return cls(SparsityPattern(columns, width).matrix(values))

    @property
    def T(self) -> LinearMap:  # noqa: N802 - the name that numpy and torch use
        """The transpose."""
        return LinearMap(self.transposed, self.matrix)

    def __matmul__(self, dense: Float[Tensor, "W C"]) -> Float[Tensor, "R C"]:
        return _Product.apply(dense, self)


class _Product(torch.autograd.Function):
    @staticmethod
    def forward(ctx, dense, linear_map):  # type: ignore[no-untyped-def]
        ctx.linear_map = linear_map
        if linear_map.is_dense:
            return _few_rows_times(dense.T, linear_map.transposed).T
        return linear_map.matrix @ dense

    @staticmethod
    def backward(ctx, gradient):  # type: ignore[no-untyped-def]
        if ctx.linear_map.is_dense:
            return _few_rows_times(gradient.T, ctx.linear_map.matrix).T, None
        return ctx.linear_map.transposed @ gradient.contiguous(), None


def _few_rows_times(rows: Float[Tensor, "C K"], matrix: Float[Tensor, "K N"]) -> Float[Tensor, "C N"]:
    """`rows @ matrix`, which is three times faster than the matrix times a few columns.

    On a CPU a large product is the sum of many: a product of three rows runs on one thread, and a batch on all.
    """
    parts = len(matrix) // ROWS_AT_ONCE
    if matrix.device.type != "cpu" or parts < 2 or matrix.numel() < LARGE_MATRIX:
        return rows @ matrix
    end = parts * ROWS_AT_ONCE
    batch = rows[:, :end].reshape(len(rows), parts, ROWS_AT_ONCE).transpose(0, 1)
    found = (batch @ matrix[:end].reshape(parts, ROWS_AT_ONCE, -1)).sum(dim=0)
    return found if end == len(matrix) else found + rows[:, end:] @ matrix[end:]


def _transposed(matrix: Tensor) -> Tensor:
    """A copy of the transpose, in the same layout."""
    if matrix.layout != torch.sparse_csr:
        return matrix.T.contiguous()
    from scipy.sparse import csr_matrix

    parts = matrix.values(), matrix.col_indices(), matrix.crow_indices()
    device = matrix.device
    by_column = csr_matrix(tuple(part.cpu().numpy() for part in parts), tuple(matrix.shape)).tocsc()
    start, owner, values = (
        torch.from_numpy(part).to(device) for part in (by_column.indptr, by_column.indices, by_column.data)
    )
    return compressed(start, owner, values, (matrix.shape[1], matrix.shape[0]))


def compressed(start: Tensor, columns: Tensor, values: Tensor, size: tuple[int, int]) -> Tensor:
    """A CSR tensor without torch's warning that such tensors are in beta."""
    _spend_beta_warning()
    return torch.sparse_csr_tensor(start, columns, values, size, check_invariants=False)


def compressed_sum(
    rows: Int[Tensor, " N"], columns: Int[Tensor, " N"], values: Tensor, size: tuple[int, int]
) -> Tensor:
    """A CSR tensor of entries in any order; those of one place are added."""
    _spend_beta_warning()
    entries = torch.sparse_coo_tensor(torch.stack([rows, columns]), values, size, check_invariants=False)
    found = entries.coalesce().to_sparse_csr()
    # a product copies 64-bit indices to 32-bit ones each time, which takes two thirds of the time of its arithmetic
    return compressed(found.crow_indices().int(), found.col_indices().int(), found.values(), size)


@cache
def _spend_beta_warning() -> None:
    """Makes the first CSR tensor of the process: torch warns once. Filters are not changed for each tensor, because
    they belong to the process, and fits run on several threads.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.sparse_csr_tensor([0, 1], [0], [1.0], (1, 1), check_invariants=False)
