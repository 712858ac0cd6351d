"""Where a value or gradient is not finite: the view, the vertices, the texels."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import torch
from torch import Tensor

from hir_core.scene import Mesh

MAX_LISTED = 5
"""More views or vertices are only counted."""


def nonfinite_views(mesh: Mesh, views: Sequence[int], names: Sequence[str], loss: Callable[[Mesh, int], Tensor]) -> str:
    """The views whose loss, or its gradient in the positions, is not finite, and the vertices of that gradient."""
    parts = []
    for view in views:
        value, broken = _probe(mesh, partial(_of_view, loss, view))
        if not value:
            parts.append(f"view {names[view]}")
        elif len(broken):
            parts.append(f"view {names[view]}, {_listed('vertex', 'vertices', broken.tolist())}")
    return "; ".join(parts[:MAX_LISTED]) + (
        f" and {len(parts) - MAX_LISTED} more views" if len(parts) > MAX_LISTED else ""
    )


def _of_view(loss: Callable[[Mesh, int], Tensor], view: int, mesh: Mesh) -> Tensor:
    return loss(mesh, view)


def nonfinite_vertices(mesh: Mesh, term: Callable[[Mesh], Tensor]) -> str:
    """The vertices at which a term's gradient is not finite; "" if only its value is not."""
    _, broken = _probe(mesh, term)
    return _listed("vertex", "vertices", broken.tolist()) if len(broken) else ""


def nonfinite_elements(named: Mapping[str, Tensor]) -> str:
    """The names of tensors whose values or gradients are not finite, and the indices, of texels row and column."""
    parts = []
    for name, leaf in named.items():
        for what, values in (("", leaf.detach()), ("gradient of ", leaf.grad)):
            if values is None or bool(torch.isfinite(values).all()):
                continue
            bad = ~torch.isfinite(values)
            indices = (bad.any(dim=-1) if bad.ndim > 1 else bad).nonzero().tolist()
            parts.append(f"{what}{name}, {_listed('index', 'indices', indices)}")
    return "; ".join(parts)


def _probe(mesh: Mesh, loss: Callable[[Mesh], Tensor]) -> tuple[bool, Tensor]:
    """Whether the value is finite, and the vertices whose position or gradient is not."""
    positions = mesh.positions.detach().clone().requires_grad_(True)
    value = loss(mesh.with_positions(positions)).sum()
    broken = ~torch.isfinite(positions.detach()).all(dim=1)
    if value.requires_grad and bool(torch.isfinite(value)):
        (gradient,) = torch.autograd.grad(value, positions, allow_unused=True)
        if gradient is not None:
            broken |= ~torch.isfinite(gradient).all(dim=1)
    return bool(torch.isfinite(value)), broken.nonzero()[:, 0]


def _listed(one: str, many: str, items: Sequence[object]) -> str:
    shown = ", ".join(str(item) for item in items[:MAX_LISTED])
    if len(items) <= MAX_LISTED:
        return f"{one if len(items) == 1 else many} {shown}"
    return f"{len(items)} {many} ({shown}, …)"
