"""Errors of a fit against a photograph: PSNR, SSIM, LPIPS, FLIP, masks (docs/evaluation.md), on numpy arrays.

One definition everywhere: fit and photograph are each composited over black with their **own** coverage, as
sRGB × coverage, in the 8-bit range and clipped, never rounded. `frame` is over all pixels, `object` over pixels of true
coverage > 0.5.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from hir_exporters.conventions import SRGB_POWER, linear_to_srgb
from numpy.typing import NDArray

from hir_core.errors import InputError

Image = NDArray[np.float32]

Perceptual = Callable[[Image, Image], float]
"""A distance of two pictures (H, W, 3) in 0…1: of the fit and of the truth."""

OBJECT_COVERAGE: Final = 0.5
"""True coverage above which a pixel belongs to the object."""

PSNR_MAX: Final = 100.0
"""dB for equal images; infinity would make every mean infinite."""


def composite(color_linear: Image, coverage: Image) -> Image:
    """Picture (H, W, 3) in 0…1 over black: sRGB of the clipped colour (H, W, 3, unassociated) times coverage (H, W).

    `InputError` for NaN: black in its place would have figures like any other picture.
    """
    if np.isnan(color_linear).any() or np.isnan(coverage).any():
        raise InputError("a picture contains pixels that are no number; no figure can be computed from it")
    color, alpha = np.clip(color_linear, 0.0, 1.0), np.clip(coverage, 0.0, 1.0)
    return np.asarray(linear_to_srgb(color) * alpha[..., None], dtype=np.float32)


def unassociate(premultiplied: Image) -> tuple[Image, Image]:
    """Colour (H, W, 3) and coverage (H, W) of a render (H, W, 4); black where the coverage is 0."""
    alpha = np.clip(premultiplied[..., 3], 0.0, 1.0)
    color = premultiplied[..., :3] / np.maximum(alpha, 1e-6)[..., None]
    return np.where(alpha[..., None] > 0, color, 0.0).astype(np.float32), alpha.astype(np.float32)


def psnr(fit: Image, truth: Image, where: NDArray[np.bool_] | None = None) -> float | None:
    """Peak signal to noise ratio in dB of pictures in 0…1; at most `PSNR_MAX`; None without a pixel.

    A compared pixel that is not finite raises `InputError`.
    """
    return psnr_without_noise(fit, fit, truth, where)


def psnr_without_noise(
    first: Image, second: Image, truth: Image, where: NDArray[np.bool_] | None = None
) -> float | None:
    """PSNR of the noise-free render, estimated from two renders with independent noise.

    The mean product of their differences from the truth has no noise term. With one render twice it is `psnr`. A
    compared pixel that is not finite raises `InputError`.
    """
    product = (np.asarray(first, np.float64) - truth) * (np.asarray(second, np.float64) - truth)
    if where is not None:
        product = product[where]
    if product.size == 0:
        return None
    error = float(np.mean(product))
    if not np.isfinite(error):
        raise InputError("the compared pictures contain pixels that are not finite; mask or replace them first")
    return min(PSNR_MAX, -10.0 * float(np.log10(error))) if error > 0 else PSNR_MAX


def ssim(fit: Image, truth: Image) -> float | None:
    """Structural similarity (Wang et al. 2004): Gaussian window of σ 1.5, population covariance, mean over channels.

    None where the picture is smaller than the window (11 pixels).
    """
    from skimage.metrics import structural_similarity

    if min(truth.shape[:2]) < 11:
        return None
    value = structural_similarity(  # type: ignore[no-untyped-call,unused-ignore]
        np.asarray(truth, np.float64),
        np.asarray(fit, np.float64),
        data_range=1.0,
        channel_axis=2,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
    )
    return float(value)


class ChannelScale:
    """The linear factor (3,) per channel that brings fits nearest to truths as sRGB, accumulated image by image.

    A power of 1/2.4 stands for the curve of sRGB, which has this power above its toe: then least squares have a closed
    form. With squares of linear colours a few highlights would decide.
    """

    def __init__(self) -> None:
        self._power = np.zeros(3)
        self._product = np.zeros(3)

    def add(self, fit_linear: Image, true_linear: Image) -> None:
        """Adds linear colours (N, 3) of the fit and of the truth at the same pixels."""
        fit, truth = (np.maximum(np.asarray(c, np.float64), 0) ** (1 / SRGB_POWER) for c in (fit_linear, true_linear))
        self._power += (fit * fit).sum(axis=0)
        self._product += (fit * truth).sum(axis=0)

    @property
    def value(self) -> NDArray[np.float64]:
        """The factor; 1 where the fit is black."""
        found = np.where(self._power > 0, self._product / np.maximum(self._power, 1e-300), 1.0)
        return np.asarray(found**SRGB_POWER)


def nearest_exposure(fit_linear: Image, true_linear: Image) -> NDArray[np.float64]:
    """The factor (3,) per channel that brings linear colours (N, 3) of one fit nearest to those of a photograph:
    `ChannelScale` of one picture.
    """
    scale = ChannelScale()
    scale.add(fit_linear, true_linear)
    return scale.value


@dataclass(frozen=True)
class Figures:
    """Error of one picture."""

    frame: float | None
    object: float | None
    ssim: float | None
    lpips: float | None
    flip: float | None

    def document(self) -> dict[str, Any]:
        """For metrics.json."""
        return {
            "psnr": {"frame": self.frame, "object": self.object},
            "ssim": self.ssim,
            "lpips": self.lpips,
            "flip": self.flip,
        }


def compare(
    fit: Image, truth: Image, true_coverage: Image, lpips: Perceptual | None = None, flip: Perceptual | None = None
) -> Figures:
    """All metrics of two composited images."""
    inside = true_coverage > OBJECT_COVERAGE
    return Figures(
        psnr(fit, truth),
        psnr(fit, truth, inside),
        ssim(fit, truth),
        None if lpips is None else lpips(fit, truth),
        None if flip is None else flip(fit, truth),
    )


def mask_iou(fit: Image, truth: Image) -> float | None:
    """Intersection over union of two coverages (H, W), each thresholded at one half; None where both are empty."""
    fit_mask, true_mask = fit > OBJECT_COVERAGE, truth > OBJECT_COVERAGE
    union = int((fit_mask | true_mask).sum())
    return int((fit_mask & true_mask).sum()) / union if union else None


def mean(values: list[float | None]) -> float | None:
    """Mean without the None values; None where all are None."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
