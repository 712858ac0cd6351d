"""Lat-long coordinates of directions for Dr.Jit arrays (docs/conventions.md)."""

from __future__ import annotations

import drjit as dr

from hir_plugins.reflectance_renderers.drjit_types import DrJitArray


def latlong_coordinates(direction: DrJitArray) -> tuple[DrJitArray, DrJitArray]:
    """(u, v) in [0, 1] of `hir_exporters.conventions.direction_to_latlong_uv`, for unit directions."""
    u = 0.5 - dr.atan2(direction.x, direction.z) / dr.two_pi
    # near a pole acos loses all digits: within 3e-4 rad every direction would be the pole
    v = dr.atan2(dr.sqrt(dr.square(direction.x) + dr.square(direction.z)), direction.y) * dr.inv_pi
    return dr.clip(u, 0, 1), dr.clip(v, 0, 1)
