"""The rule for clipped pixels for Dr.Jit arrays; see `hir_core.optimization.clipped_pixels`."""

from __future__ import annotations

import drjit as dr

from hir_plugins.reflectance_renderers.drjit_types import DrJitArray


def without_clipped_excess(difference: DrJitArray, clipped: DrJitArray) -> DrJitArray:
    """`difference` (prediction minus photograph), with 0 where the photograph is `clipped` and darker."""
    return dr.select(clipped & (difference > 0), 0, difference)
