"""Detail images: what photographs are compared by when the surface is refined.

Detail, not colour, is compared: each photograph minus its local mean, divided by its local contrast. Highlights, slow
shadows and differences of exposure cancel, as in the normalised correlation of Vu, Labatut, Pons & Keriven 2012, *High
Accuracy and Visibility-Consistent Dense Multiview Stereo*.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from torch import Tensor

from hir_core.capture import Camera, View
from hir_core.optimization.parallel_jobs import StopSignal, run_in_parallel
from hir_core.scene.srgb import linear_to_srgb

WINDOW_PIXELS = 7
"""Side of the box (applied twice) that local means and contrasts are taken over."""

LEAST_CONTRAST_SRGB = 0.03
"""Contrast (standard deviation in sRGB) below which detail fades out, because noise dominates there."""

LEAST_COVERAGE = 0.99
"""Mask value from which a pixel belongs to the object alone."""

DETAIL_BYTES_MAX = 512 << 20
"""Of the detail images of all views; larger photographs are compared at a fraction of their resolution."""

BYTES_PER_PIXEL = 7
"""Three float16 channels and one mask byte."""

VIEWS_AT_ONCE = 2
"""Each needs float32 copies of its photograph (`memory_plan`)."""

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class DetailImages:
    """The detail of every view at one resolution, padded to one size."""

    images: Float[Tensor, "N H W 3"]
    """float16: as precise as the photographs, and half the memory."""
    square_inside: Bool[Tensor, "N H W"]
    """Whether a pixel and those to its right, below it and below to the right are inside the object."""
    pixels: tuple[NDArray[np.int32], ...]
    """For each view, the (x, y) of pixels whose whole window lies inside the object."""
    cameras: tuple[Camera, ...]
    names: tuple[str, ...]

    @classmethod
    def of(cls, views: Sequence[View], downsample: int, device: torch.device | str = "cpu") -> DetailImages:
        """Reads the photographs; a view without a mask counts as covered everywhere. `device` holds the images."""
        cameras = tuple(view.camera.downsampled(downsample) for view in views if view.camera is not None)
        height, width = max(c.height for c in cameras), max(c.width for c in cameras)
        images = torch.zeros(len(views), height, width, 3, dtype=torch.float16, device=device)
        square_inside = torch.zeros(len(views), height, width, dtype=torch.bool, device=device)

        def fill(i: int) -> NDArray[np.int32]:
            # few at a time: float32 copies of all views would take twice the memory
            detail, mask = detail_image(views[i], downsample)
            h, w = mask.shape
            images[i, :h, :w] = detail.half().permute(1, 2, 0).to(device)
            square_inside[i, : h - 1, : w - 1] = whole_squares(mask).to(device)
            return np.argwhere(mask.numpy())[:, ::-1].astype(np.int32)

        pixels = of_each_view(fill, len(views))
        return cls(images, square_inside, tuple(pixels), cameras, tuple(view.name for view in views))

    @cached_property
    def centers(self) -> Float[Tensor, "N 3"]:
        """Positions of the cameras."""
        centers = np.stack([camera.center for camera in self.cameras]).astype(np.float32)
        return torch.from_numpy(centers).to(self.images.device)

    @cached_property
    def projections(self) -> Float[Tensor, "N 3 4"]:
        """From homogeneous positions to homogeneous pixel coordinates."""
        matrices = np.stack([camera.intrinsics @ camera.world_to_camera[:3] for camera in self.cameras])
        return torch.from_numpy(matrices.astype(np.float32)).to(self.images.device)


def of_each_view(function: Callable[[int], T], views: int) -> list[T]:
    """The results for all views, in their order, on as many threads as torch has, at most `VIEWS_AT_ONCE`."""
    jobs = [partial(function, view) for view in range(views)]
    return run_in_parallel(jobs, min(torch.get_num_threads(), VIEWS_AT_ONCE), StopSignal())


def finest_downsample(views: Sequence[View], downsample: int) -> int:
    """The least factor, `downsample` times a power of two, at which the detail of all views fits `DETAIL_BYTES_MAX`."""
    cameras = [view.camera for view in views if view.camera is not None]
    pixels = len(cameras) * max((c.width * c.height for c in cameras), default=0)
    while pixels * BYTES_PER_PIXEL / downsample**2 > DETAIL_BYTES_MAX:
        downsample *= 2
    return downsample


def detail_image(view: View, downsample: int) -> tuple[Float[Tensor, "3 H W"], Bool[Tensor, "H W"]]:
    """The detail of one view, 0 outside the object, and the pixels whose whole window lies inside the object."""
    pixels = view.pixels(downsample)
    color = torch.from_numpy(np.ascontiguousarray(pixels.color_linear, dtype=np.float32))
    known = torch.isfinite(color).all(dim=2)  # non-finite pixels are not compared
    color = linear_to_srgb(torch.where(known[..., None], color, 0.0).clamp(0, 1)).permute(2, 0, 1)
    mask = torch.ones(color.shape[1:]) if pixels.mask is None else torch.from_numpy(pixels.mask.astype(np.float32))
    mask = mask * known
    covered = (mask >= LEAST_COVERAGE).float()[None]
    weight = box_blur(covered).clamp_min(1e-3)
    detail = (color - box_blur(color * covered) / weight) * covered
    contrast = box_blur(detail.square().mean(dim=0, keepdim=True)) / weight
    # beside the outline half of the window is empty, and the detail depends on the view
    whole = -torch.nn.functional.max_pool2d(-covered, 5, 1, 2)
    return detail / (contrast + LEAST_CONTRAST_SRGB**2).sqrt(), whole[0] > 0.5


def whole_squares(inside: Bool[Tensor, "H W"]) -> Bool[Tensor, "H-1 W-1"]:
    """Whether a pixel and those to its right, below it and below to the right are inside."""
    return inside[:-1, :-1] & inside[:-1, 1:] & inside[1:, :-1] & inside[1:, 1:]


def box_blur(image: Float[Tensor, "C H W"]) -> Float[Tensor, "C H W"]:
    """Box means, applied twice; a box that crosses the border of the image is cut there."""
    values = image.numpy()
    for _ in range(2):
        for axis in (1, 2):
            filled = uniform_filter1d(np.ones(values.shape[axis], np.float32), WINDOW_PIXELS, mode="constant")
            total = uniform_filter1d(values, WINDOW_PIXELS, axis, mode="constant")
            values = total / (filled[:, None] if axis == 1 else filled)
    return torch.from_numpy(values)
