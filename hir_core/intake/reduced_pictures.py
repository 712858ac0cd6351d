"""Photographs reduced to a maximum side, with their cameras."""

from __future__ import annotations

from hir_core.capture import Camera, Pixels, View


def reduce_to_side(view: View, pixels: Pixels, side: int) -> tuple[Pixels, Camera | None]:
    factor = max(1, -(-max(pixels.color_linear.shape[:2]) // side))
    return pixels.downsampled(factor), None if view.camera is None else view.camera.downsampled(factor)
