"""Depth jumps of a mesh in a view."""

from __future__ import annotations

import numpy as np

from hir_core.stages.geometry.depth_jumps import beside_jumps


def test_depth_jumps_are_steps_and_not_slopes() -> None:
    x = np.arange(40, dtype=np.float32)
    slope = np.tile(2 + 0.02 * x, (20, 1)).astype(np.float32)
    assert not beside_jumps(slope, 0.01, 2)[:, 2:-2].any()
    step = np.where(x < 20, 2.0, 2.2) + 0 * slope
    found = beside_jumps(step.astype(np.float32), 0.01, 2)
    assert found[:, 18:22].all() and not found[:, :17].any() and not found[:, 23:].any()
    assert not beside_jumps(np.full((5, 5), np.inf, np.float32), 0.01, 1).any()
    large = beside_jumps(step.astype(np.float32), 0.01, 2, least_jump=12.0)
    assert not large.any(), "a jump of ten pixels"
    cut = step.astype(np.float32)
    cut[:, 30:] = np.inf
    assert beside_jumps(cut, 0.01, 1)[:, 29].all() and not beside_jumps(cut, 0.01, 1, outlines=False)[:, 24:].any()
