"""The transfer function of sRGB for Dr.Jit arrays."""

from __future__ import annotations

import drjit as dr

from hir_plugins.reflectance_renderers.drjit_types import DrJitArray


def linear_to_srgb(value: DrJitArray) -> DrJitArray:
    """sRGB of linear values; negative values count as 0."""
    return linear_to_srgb_and_slope(value)[0]


def linear_to_srgb_and_slope(value: DrJitArray) -> tuple[DrJitArray, DrJitArray]:
    """sRGB of linear values, and its derivative."""
    value = dr.maximum(value, 0)
    curved = dr.maximum(value, 0.0031308)
    power = 1.055 * dr.power(curved, 1 / 2.4)
    low = value < 0.0031308
    return dr.select(low, 12.92 * value, power - 0.055), dr.select(low, 12.92, power / (2.4 * curved))
