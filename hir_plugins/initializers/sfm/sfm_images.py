"""The images of structure from motion: photographs of any format, written as 8-bit files that COLMAP can read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from hir_exporters.conventions import linear_to_srgb
from hir_exporters.files.atomic import atomic_path
from numpy.typing import NDArray

from hir_core.capture import Camera, Pixels, View
from hir_core.capture.exif import CameraRecord, camera_record

_MASK_MARGIN_SHARE = 0.01
"""Features may lie outside the mask by this share of the image's longer side: outlines are features too."""
_DEFAULT_FOCAL_OVER_SIDE = 1.2
"""Focal length over the image's longer side where EXIF does not give it."""


@dataclass(frozen=True)
class SfmImage:
    """One image in the working folder."""

    view: int
    """Index of its view."""
    file: str
    """Path relative to the folder of images."""
    width: int
    height: int
    factor: int
    """Factor by which the photograph was reduced."""
    record: CameraRecord
    parameters: tuple[float, ...] = ()
    """fx, fy, cx, cy in pixels of this image if its camera is known; the image is then undistorted."""

    @property
    def focal(self) -> float:
        """Focal length in pixels of this image, from EXIF, else 1.2 times the longer side."""
        return (self.record.focal_over_width or _DEFAULT_FOCAL_OVER_SIDE) * max(self.width, self.height)


def write_images(views: Sequence[View], folder: Path, max_size: int, known: bool) -> tuple[list[SfmImage], bool]:
    """Writes `folder`/images and, for views with masks, `folder`/masks; existing files are kept.

    If cameras are `known`, the images are undistorted. Returns the images, and whether all have masks.
    """
    images: list[SfmImage] = []
    masked = True
    for index, view in enumerate(views):
        file = f"{index:05d}.jpg"
        target, mask_target = folder / "images" / file, folder / "masks" / f"{file}.png"
        # an unknown lens is estimated from the image as taken
        pixels = view.pixels() if known else view.read()
        height, width = pixels.color_linear.shape[:2]
        factor = -(-max(width, height) // max_size)
        mask = view.mask if view.mask is not None else pixels.mask
        masked = masked and mask is not None
        if not target.is_file():
            _write(target, pixels, factor)
        if mask is not None and not mask_target.is_file():
            _write_mask(mask_target, mask, factor)
        record = camera_record(view.path) if view.path is not None else CameraRecord()
        parameters = _pinhole(view.camera.downsampled(factor)) if known and view.camera is not None else ()
        images.append(SfmImage(index, file, width // factor, height // factor, factor, record, parameters))
    return images, masked and bool(images)


def camera_groups(images: Sequence[SfmImage], mode: str) -> list[list[SfmImage]]:
    """Images that share intrinsics: those of one size, model and focal length (`auto`), of one size, or none."""
    groups: dict[object, list[SfmImage]] = {}
    for image in images:
        key: object = (image.width, image.height, image.parameters)
        if mode == "auto":
            key = (key, image.record.model, round(image.record.focal_over_width, 4))
        elif mode == "each":
            key = image.file
        groups.setdefault(key, []).append(image)
    return list(groups.values())


def _pinhole(camera: Camera) -> tuple[float, ...]:
    k = camera.intrinsics
    return float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2])


def _write(target: Path, pixels: Pixels, factor: int) -> None:
    from PIL import Image

    small = Pixels(pixels.color_linear, None, pixels.saturated).downsampled(factor)
    encoded = np.rint(np.clip(linear_to_srgb(small.color_linear), 0, 1) * 255).astype(np.uint8)
    with atomic_path(target) as temporary:
        Image.fromarray(encoded).save(temporary, format="JPEG", quality=96, subsampling=0)


def _write_mask(target: Path, mask: NDArray[np.float32], factor: int) -> None:
    import cv2
    from PIL import Image

    height, width = mask.shape[0] // factor, mask.shape[1] // factor
    blocks = mask[: height * factor, : width * factor].reshape(height, factor, width, factor).mean(axis=(1, 3))
    margin = max(1, round(_MASK_MARGIN_SHARE * max(height, width)))
    kernel = np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)
    grown = cv2.dilate((blocks > 0.5).astype(np.uint8) * 255, kernel)
    with atomic_path(target) as temporary:
        Image.fromarray(grown).save(temporary, format="PNG")
