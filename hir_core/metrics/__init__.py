"""Errors of a fit against the truth (docs/evaluation.md): images, surfaces, albedo, light."""

from hir_core.metrics.image_metrics import (
    OBJECT_COVERAGE,
    PSNR_MAX,
    ChannelScale,
    Figures,
    Image,
    Perceptual,
    compare,
    composite,
    mask_iou,
    mean,
    nearest_exposure,
    psnr,
    psnr_without_noise,
    ssim,
    unassociate,
)

__all__ = [
    "OBJECT_COVERAGE",
    "PSNR_MAX",
    "ChannelScale",
    "Figures",
    "Image",
    "Perceptual",
    "compare",
    "composite",
    "mask_iou",
    "mean",
    "nearest_exposure",
    "psnr",
    "psnr_without_noise",
    "ssim",
    "unassociate",
]
