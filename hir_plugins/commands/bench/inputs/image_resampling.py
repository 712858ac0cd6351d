"""Downsampled and enlarged copies of photographs with transparency."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
from hir_exporters.conventions import linear_to_srgb, srgb_to_linear
from hir_exporters.textures.image_files import read_ldr, write_png
from hir_exporters.textures.pillow_images import open_image
from numpy.typing import NDArray


def downsample_rgba(image: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """An sRGB image with straight alpha (H, W, 4) at 1/`factor`: linear colours are averaged, weighted by coverage."""
    height, width = image.shape[0] // factor, image.shape[1] // factor
    blocks = image[: height * factor, : width * factor].reshape(height, factor, width, factor, 4)
    alpha = blocks[..., 3:]
    light = (np.asarray(srgb_to_linear(blocks[..., :3])) * alpha).sum(axis=(1, 3))
    covered = alpha.sum(axis=(1, 3))
    color = linear_to_srgb(np.where(covered > 0, light / np.maximum(covered, 1e-9), 0.0))
    return np.concatenate([color, covered / factor**2], axis=2).astype(np.float32)


def copy_downsampled(source: Path, target: Path, side: int) -> None:
    """Writes the image at the largest whole-number reduction that keeps `side` pixels; copies smaller images."""
    target.parent.mkdir(parents=True, exist_ok=True)
    image = read_ldr(source)
    factor = image.shape[0] // side
    if factor <= 1:
        shutil.copy(source, target)
    else:
        write_png(target, downsample_rgba(image, factor))


def copy_enlarged(source: Path, target: Path, side: int) -> None:
    """Writes the image with a width of `side` pixels by bicubic interpolation; copies larger images."""
    from PIL import Image

    with open_image(source) as image:
        if max(image.size) >= side:
            shutil.copy(source, target)
            return
        size = (side, round(side * image.height / image.width))
        image.convert("RGBA").convert("RGBa").resize(size, Image.Resampling.BICUBIC).convert("RGBA").save(target)
