"""Figures that say how far a fit is from the truth (docs/evaluation.md): pictures, surfaces, albedo, light."""

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
    "psnr",
    "psnr_without_noise",
    "ssim",
    "unassociate",
]
