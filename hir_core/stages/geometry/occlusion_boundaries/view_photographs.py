"""The photographs of all views in sRGB, padded to one size, with lookups at fractional pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from numpy.typing import NDArray
from torch import Tensor

from hir_core.capture import Camera, View
from hir_core.scene.srgb import linear_to_srgb, srgb_to_linear
from hir_core.stages.geometry.photo_consistency.detail_images import LEAST_COVERAGE


@dataclass(frozen=True, eq=False)
class ViewPhotographs:
    """Photographs and masks at one resolution."""

    images: UInt8[Tensor, "N H W 3"]
    """sRGB in 8 bits: the colours are compared with noise that is larger."""
    inside: Bool[Tensor, "N H W"]
    """Pixels that the object covers entirely, and whose colour is known."""
    outside: Bool[Tensor, "N H W"]
    """Pixels of the view that the object does not touch."""
    areas: Float[Tensor, " N"]
    """Area of each mask in pixels."""
    cameras: tuple[Camera, ...]

    @classmethod
    def of(cls, views: Sequence[View], downsample: int, device: torch.device | str = "cpu") -> ViewPhotographs:
        """Reads the photographs; a view without a mask counts as covered everywhere. `device` holds the images."""
        cameras = tuple(view.camera.downsampled(downsample) for view in views if view.camera is not None)
        height, width = max(c.height for c in cameras), max(c.width for c in cameras)
        images = torch.zeros(len(views), height, width, 3, dtype=torch.uint8, device=device)
        inside, outside = torch.zeros(2, len(views), height, width, dtype=torch.bool, device=device)
        areas = []
        for i, view in enumerate(views):
            pixels = view.pixels(downsample)
            color = torch.from_numpy(np.ascontiguousarray(pixels.color_linear, dtype=np.float32))
            known = torch.isfinite(color).all(dim=2)
            color = linear_to_srgb(torch.where(known[..., None], color, 0.0).clamp(0, 1))
            mask = torch.ones(known.shape) if pixels.mask is None else torch.from_numpy(pixels.mask.astype(np.float32))
            h, w = known.shape
            images[i, :h, :w] = (color * 255).round().to(torch.uint8).to(device)
            inside[i, :h, :w] = (known & (mask >= LEAST_COVERAGE)).to(device)
            outside[i, :h, :w] = (mask <= 1 - LEAST_COVERAGE).to(device)
            areas.append(float(mask.sum()))
        return cls(
            images, inside, outside, torch.tensor(areas, dtype=torch.float64, device=device).clamp_min(1.0), cameras
        )

    def multiplied(self, factors: Float[NDArray[np.floating], "N 3"]) -> ViewPhotographs:
        """The photographs with their linear values multiplied; above 1 they are clipped."""
        levels = srgb_to_linear(torch.arange(256, device=self.images.device) / 255.0)
        images = self.images.clone()
        for image, row in zip(images, torch.from_numpy(factors).to(levels), strict=True):
            table = (linear_to_srgb((levels * row[:, None]).clamp(0, 1)) * 255).round().to(torch.uint8)
            for channel in range(3):
                image[..., channel] = table[channel][image[..., channel].long()]
        return replace(self, images=images)

    @cached_property
    def centers(self) -> Float[Tensor, "N 3"]:
        """Positions of the cameras, float64."""
        centers = np.stack([np.asarray(camera.center, np.float64) for camera in self.cameras])
        return torch.from_numpy(centers).to(self.images.device)

    @cached_property
    def _projections(self) -> Float[Tensor, "N 3 4"]:
        """From homogeneous positions to homogeneous pixel coordinates, float64."""
        matrices = np.stack([camera.intrinsics @ camera.world_to_camera[:3] for camera in self.cameras])
        return torch.from_numpy(matrices.astype(np.float64)).to(self.images.device)

    def project(self, points: Float[Tensor, "Q 3"], view: Int[Tensor, " Q"]) -> Float[Tensor, "Q 2"]:
        """Pixels of points (float64); differentiable. NaN where a point is not in front of its camera."""
        matrix = self._projections[view]
        homogeneous = (matrix[..., :3] @ points[..., None])[..., 0] + matrix[..., 3]
        depth = homogeneous[..., 2:]
        return homogeneous[..., :2] / torch.where(depth > 1e-12, depth, torch.nan)

    def pixel_angle(self, view: int) -> float:
        """Width of a pixel at distance 1, in the middle of the view."""
        return float(1 / self.cameras[view].intrinsics[0, 0])

    def colors_at(
        self, view: Int[Tensor, " Q"], pixels: Float[Tensor, "Q 2"]
    ) -> tuple[Float[Tensor, "Q 3"], Bool[Tensor, " Q"]]:
        """Bilinear sRGB 0…1 at pixel coordinates (centres at .5), and where all four pixels lie inside the object; 0
        outside the image.
        """
        _, height, width, _ = self.images.shape
        corner = (pixels - 0.5).floor()
        limit = torch.tensor([width - 1, height - 1], device=pixels.device)
        within = torch.isfinite(pixels).all(dim=1) & ((corner >= 0) & (corner < limit)).all(dim=1)
        corner = torch.where(within[:, None], corner, 0.0)
        x, y = corner.long().unbind(1)
        fx, fy = torch.where(within[:, None], pixels - 0.5 - corner, 0.0).float().unbind(1)
        first = (view * height + y) * width + x
        images, inside = self.images.view(-1, 3), self.inside.view(-1)
        color = torch.zeros(len(pixels), 3, device=pixels.device)
        covered = within
        for step, weight in (
            (0, (1 - fx) * (1 - fy)),
            (1, fx * (1 - fy)),
            (width, (1 - fx) * fy),
            (width + 1, fx * fy),
        ):
            at = torch.where(within, first + step, 0)
            color += weight[:, None] * images.index_select(0, at)
            covered = covered & inside.index_select(0, at)
        return color * (within[:, None] / 255.0), covered
