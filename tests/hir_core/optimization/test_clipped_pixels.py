"""Clipped pixels: a brighter prediction has no error, a darker one has all of it."""

from __future__ import annotations

import torch

from hir_core.optimization.clipped_pixels import is_clipped_excess, without_clipped_excess


def test_only_a_prediction_brighter_than_a_clipped_pixel_has_no_error() -> None:
    difference = torch.tensor([[0.2, -0.2, 0.0], [0.2, -0.2, 0.0]], requires_grad=True)
    clipped = torch.tensor([[True], [False]])
    assert is_clipped_excess(difference, clipped).tolist() == [[True, False, False], [False, False, False]]
    residual = without_clipped_excess(difference, clipped)
    assert torch.equal(residual, torch.tensor([[0.0, -0.2, 0.0], [0.2, -0.2, 0.0]]))
    residual.sum().backward()
    assert difference.grad is not None and difference.grad.tolist() == [[0.0, 1.0, 1.0], [1.0, 1.0, 1.0]]
