"""Image errors by the conventions of published tables, for comparison with them.

The project's own definition is in `hir_core.metrics.image_metrics`. Stanford-ORB (Kuang et al. 2023) compares pixels
inside the *true* mask, eroded by 5×5 pixels, and divides by the whole frame; relit images and albedos may be scaled by
one factor per channel. The paper (Zhu et al. 2023) uses the whole frame, which is `psnr.frame`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from hir_exporters.conventions import linear_to_srgb
from numpy.typing import NDArray

from hir_core.errors import InputError
from hir_core.metrics.image_metrics import Image, Perceptual

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OrbFigures:
    """One image by the rules of Stanford-ORB."""

    psnr_h: float
    """Linear, clipped at 4, after the mean was scaled to that of the sRGB image."""
    psnr_l: float
    """sRGB, clipped at 1."""
    ssim: float
    lpips: float | None
    """With VGG."""

    def document(self) -> dict[str, Any]:
        """For metrics.json."""
        return {"psnr_h": self.psnr_h, "psnr_l": self.psnr_l, "ssim": self.ssim, "lpips": self.lpips}


def stanford_orb(
    fit_linear: Image, true_linear: Image, true_coverage: Image, scaled: bool, lpips: Perceptual | None = None
) -> OrbFigures:
    """Figures of linear, unassociated pictures (H, W, 3); `scaled` for relighting, not for novel views."""
    mask = eroded(true_coverage)
    fit, truth = masked(fit_linear, mask), np.maximum(masked(true_linear, mask), 0)
    fit = fit * best_scale(fit, truth) if scaled else fit
    shown = np.clip(truth, 0, 1).mean()
    gain = float(_srgb(np.clip(truth, 0, 1)).mean() / shown) if shown > 1e-8 else 1.0
    high = frame_psnr(np.clip(fit * gain, 0, 4), np.clip(truth * gain, 0, 4), mask)
    fit_srgb, true_srgb = _srgb(np.clip(fit, 0, 1)), _srgb(np.clip(truth, 0, 1))
    return OrbFigures(
        high,
        frame_psnr(fit_srgb, true_srgb, mask),
        float(small_window_ssim(fit_srgb, true_srgb).mean()),
        # the published code applies the sRGB curve twice before LPIPS
        None if lpips is None else lpips(_image(_srgb(fit_srgb)), _image(_srgb(true_srgb))),
    )


def stanford_orb_albedo(fit_linear: Image, true_linear: Image, true_coverage: Image) -> float:
    """PSNR of linear albedos after one factor per channel."""
    mask = eroded(true_coverage)
    fit, truth = masked(fit_linear, mask), np.maximum(masked(true_linear, mask), 0)
    return frame_psnr(np.clip(fit * best_scale(fit, truth), 0, 1), np.clip(truth, 0, 1), mask)


def eroded(coverage: Image) -> NDArray[np.bool_]:
    """Pixels (H, W) whose 5×5 neighbours inside the frame are all covered by more than a half."""
    from scipy.ndimage import minimum_filter

    # pixels outside the frame count as covered, as in the erosion of OpenCV
    return np.asarray(
        minimum_filter(np.asarray(coverage > 0.5, dtype=np.uint8), size=5, mode="constant", cval=1), dtype=bool
    )


def masked(picture: Image, mask: NDArray[np.bool_]) -> Array:
    """Black outside. A pixel inside that is not finite raises `InputError`."""
    inside = np.where(mask[..., None], np.asarray(picture, np.float64), 0.0)
    if not np.isfinite(inside).all():
        raise InputError("the compared pictures contain pixels that are not finite; mask or replace them first")
    return inside


def best_scale(fit: Array, truth: Array) -> Array:
    """Least-squares factor (3,) of each channel; 1 for a channel that is black."""
    power = (fit * fit).sum(axis=(0, 1))
    return np.where(power > 1e-6, (fit * truth).sum(axis=(0, 1)) / np.maximum(power, 1e-300), 1.0)


def frame_psnr(fit: Array, truth: Array, mask: NDArray[np.bool_]) -> float:
    """dB over the whole frame, at least that of a constant grey inside the mask."""
    error = float(np.mean((fit - truth) ** 2))
    grey = float(np.mean((0.5 * mask[..., None] - truth) ** 2))
    return min(100.0, -10 * float(np.log10(max(min(error, grey), 1e-10))))


def small_window_ssim(fit: Array, truth: Array) -> Array:
    """SSIM of the 3×3 pixels about each pixel (H, W, C), by Gaussian weights of σ 1.5; borders are mirrored."""
    from scipy.ndimage import correlate1d

    kernel = np.exp(-0.5 * (np.arange(-1, 2) / 1.5) ** 2)
    kernel /= kernel.sum()

    def blurred(values: Array) -> Array:
        return np.asarray(correlate1d(correlate1d(values, kernel, 0, mode="mirror"), kernel, 1, mode="mirror"))

    mean_fit, mean_truth = blurred(fit), blurred(truth)
    var_fit, var_truth = blurred(fit**2) - mean_fit**2, blurred(truth**2) - mean_truth**2
    covariance = blurred(fit * truth) - mean_fit * mean_truth
    c1, c2 = 0.01**2, 0.03**2
    top = (2 * mean_fit * mean_truth + c1) * (2 * covariance + c2)
    return np.asarray(top / ((mean_fit**2 + mean_truth**2 + c1) * (var_fit + var_truth + c2)))


def _srgb(values: Array) -> Array:
    return np.asarray(linear_to_srgb(values), np.float64)


def _image(values: Array) -> Image:
    return values.astype(np.float32)
