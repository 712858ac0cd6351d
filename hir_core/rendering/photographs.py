"""Photographs with masks, and the picture of the difference between a photograph and a render."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Pixels, View
from hir_core.errors import CaptureError
from hir_core.metrics import Image, composite


@dataclass(frozen=True)
class MaskedPhotograph:
    """A photograph and the mask of its object."""

    color_linear: Image
    """(H, W, 3), linear."""
    mask: Image
    """(H, W), coverage of the object, 0 to 1."""
    saturated: NDArray[np.bool_]
    """(H, W), pixels with a clipped channel."""

    @property
    def picture(self) -> Image:
        """(H, W, 3), sRGB, composited over black (`hir_core.metrics.composite`)."""
        return composite(self.color_linear, self.mask)

    def downsampled(self, factor: int) -> MaskedPhotograph:
        """At 1/`factor` of the resolution, with the filter of `Pixels.downsampled`."""
        small = Pixels(self.color_linear, self.mask, self.saturated).downsampled(factor)
        assert small.mask is not None
        return MaskedPhotograph(small.color_linear, small.mask, small.saturated)


def masked_photograph(view: View) -> MaskedPhotograph:
    """The photograph with its mask; `CaptureError` where it has none: the background would count as object.

    A pixel that is not finite is no part of the object and black, as fits leave it out.
    """
    pixels = view.pixels()
    if pixels.mask is None:
        raise CaptureError(
            f"view {view.name} has no mask, so background and object cannot be separated; add an alpha channel"
        )
    color, mask = pixels.color_linear, pixels.mask
    finite: NDArray[np.bool_] = np.all(np.isfinite(color), axis=2)
    if not finite.all():
        color, mask = np.where(finite[..., None], color, np.float32(0)), np.where(finite, mask, np.float32(0))
    return MaskedPhotograph(color, mask, pixels.saturated)


def difference_picture(fit: Image, truth: Image) -> Image:
    """Signed difference times 2.5 around grey: equal pixels are 0.5, pixels where the fit is brighter are above."""
    return np.asarray(np.clip(0.5 + 2.5 * (fit - truth), 0.0, 1.0), dtype=np.float32)
