"""Two path-traced pictures of one view with independent noise, with as many paths as their noise asks for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hir_core.metrics import OBJECT_COVERAGE, Image, composite, psnr, unassociate
from hir_core.rendering.reference_renderer import render_view

if TYPE_CHECKING:
    from hir_core.capture import Camera
    from hir_core.plugins.interfaces import ReflectanceRenderer
    from hir_core.scene import Scene

SAMPLES = 16
"""Paths per pixel of each picture of a round, for `reference_renderer`'s `max_samples`."""

MAX_ROUNDS = 4
"""At most 64 paths per pixel of each picture."""

LOW_NOISE_DB = 42.0
"""Of the mean of both pictures over the object's pixels, in sRGB: two of 255 steps."""


def converged_pair(renderer: ReflectanceRenderer, scene: Scene, camera: Camera, label: str) -> tuple[Image, Image]:
    """Two renders (H, W, 4) of equal numbers of paths; rounds are added until the noise of their mean is low.

    `renderer` is one of `SAMPLES` paths per pixel. Equal labels have equal noise, whatever was rendered before.
    """
    first, second = (render_view(renderer, scene, camera, f"{label}, {side}") for side in ("first", "second"))
    for number in range(1, MAX_ROUNDS):
        if noise_db(first, second) >= LOW_NOISE_DB:
            break
        more = (render_view(renderer, scene, camera, f"{label}, {side} {number}") for side in ("first", "second"))
        first, second = (
            (number * old + new) / np.float32(number + 1) for old, new in zip((first, second), more, strict=True)
        )
    return first, second


def noise_db(first: Image, second: Image) -> float:
    """PSNR of the mean of two renders (H, W, 4) with independent noise against the converged one; infinite without an
    object.
    """
    shown, other = (composite(*unassociate(each)) for each in (first, second))
    found = psnr(shown, other, (first[..., 3] + second[..., 3]) / 2 > OBJECT_COVERAGE)
    # their difference has twice the variance of each, their mean half of it
    return float("inf") if found is None else found + 10 * float(np.log10(4))
