"""Lens distortion, removed where pixels are read: all later code has pinhole images."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hir_core.capture.camera import Array, Camera
from hir_core.capture.pixels import Pixels
from hir_core.errors import CaptureError, MissingExtraError

MAX_DISPLACEMENT = 10.0
"""A lens whose distortion moves the border of the image further than this, in image sizes, is refused."""


@dataclass(frozen=True)
class Lens:
    """Maps pixels of a pinhole image to pixels of the image as taken."""

    intrinsics: tuple[float, float, float, float]
    """fx, fy, cx, cy of the image as taken, in pixels, centres at .5."""
    coefficients: tuple[float, ...]
    """OpenCV order: k1 k2 p1 p2 [k3 k4 k5 k6], or k1 k2 k3 k4 of a fisheye."""
    model: Literal["radial", "fisheye"]
    pinhole: tuple[float, float, float, float]
    """fx, fy, cx, cy of the undistorted image, which has the same size."""

    def distort(self, pixels: Array) -> Array:
        """The positions (N, 2) in the image as taken of pixels (N, 2) of the pinhole image."""
        fx, fy, cx, cy = self.pinhole
        x, y = (pixels[:, 0] - cx) / fx, (pixels[:, 1] - cy) / fy
        x, y = (_fisheye if self.model == "fisheye" else _radial)(x, y, self.coefficients)
        fx, fy, cx, cy = self.intrinsics
        return np.stack([x * fx + cx, y * fy + cy], axis=1)


def camera_lens(camera: Camera, distortion: tuple[float, ...]) -> Lens:
    """The lens of a camera whose undistorted image has the same intrinsics.

    Coefficients that fold the image over itself raise `CaptureError`.
    """
    k = camera.intrinsics
    intrinsics = (float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2]))
    return _checked_lens(intrinsics, tuple(distortion), camera.width, camera.height)


@lru_cache(maxsize=64)
def _checked_lens(
    intrinsics: tuple[float, float, float, float], distortion: tuple[float, ...], width: int, height: int
) -> Lens:
    """The views of a capture share one lens or few, and each reads its photograph more than once."""
    lens = Lens(intrinsics, distortion, "radial", intrinsics)
    border = lens.distort(_border(width, height)) - intrinsics[2:]
    moved, size = float(np.abs(border).max(initial=0.0)), max(width, height)
    if not moved < MAX_DISPLACEMENT * (size + max(map(abs, intrinsics[2:]))):
        raise CaptureError(f"the distortion coefficients {distortion} move the image by {moved:.3g} pixels; check them")
    if not _is_monotonic(lens, width, height):
        raise CaptureError(f"the distortion coefficients {distortion} fold the image over itself; check them")
    return lens


def fisheye_lens(
    intrinsics: tuple[float, float, float, float], coefficients: tuple[float, ...], width: int, height: int
) -> Lens:
    """The fisheye lens whose pinhole image shows as much as possible of the image as taken.

    The pinhole camera keeps the principal point and is zoomed until its border lies inside. `CaptureError` where no
    zoom between 0.25 and 2 achieves that.
    """
    fx, fy, cx, cy = intrinsics
    low, high = 0.25, 2.0

    def fits(zoom: float) -> bool:
        lens = Lens(intrinsics, coefficients, "fisheye", (fx * zoom, fy * zoom, cx, cy))
        border = lens.distort(_border(width, height))
        return bool(
            np.isfinite(border).all()
            and (border >= -1e-6).all()
            and (border[:, 0] <= width + 1e-6).all()
            and (border[:, 1] <= height + 1e-6).all()
            and _is_monotonic(lens, width, height)
        )

    if not fits(high):
        raise CaptureError(f"the distortion coefficients {coefficients} fold the image over itself; check them")
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (low, middle) if fits(middle) else (middle, high)
    return Lens(intrinsics, coefficients, "fisheye", (fx * high, fy * high, cx, cy))


def undistort(pixels: Pixels, lens: Lens) -> Pixels:
    """The pinhole image, bilinear in linear light; a pixel next to a clipped one counts as clipped.

    Outside the image as taken (in corners, at strong pincushion distortion) its nearest pixel is repeated.
    """
    color = resample(pixels.color_linear, lens)
    mask = None if pixels.mask is None else resample(pixels.mask, lens)
    if mask is not None and pixels.mask is not None:
        # weighted by the mask, so that the background does not bleed into the edge of the object
        weighted = resample(pixels.color_linear * pixels.mask[..., None], lens)
        color = np.where(mask[..., None] > 1e-3, weighted / np.maximum(mask[..., None], 1e-3), color)
    return Pixels(color, mask, resample(pixels.saturated.astype(np.float32), lens) > 0)


def resample(image: NDArray[np.float32], lens: Lens) -> NDArray[np.float32]:
    """An image as taken (H W or H W C), resampled at the pixels of the pinhole image."""
    try:
        import cv2
    except ImportError:
        raise MissingExtraError(
            "removing lens distortion needs opencv; install it with: pip install 'hir[reconstruct]'"
        ) from None
    columns, rows = _lookup(lens, *image.shape[:2])
    moved = cv2.remap(image, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(moved, dtype=np.float32)


@lru_cache(maxsize=2)
def _lookup(lens: Lens, height: int, width: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Columns and rows (H, W) in OpenCV's convention; cached, because most captures have one lens."""
    columns = np.arange(width, dtype=np.float64) + 0.5
    lookup = np.empty((height, width, 2), dtype=np.float32)
    for row in range(height):  # row by row: the float64 of a whole large image would take gigabytes
        # OpenCV's pixel centres lie at whole numbers, ours at .5
        lookup[row] = lens.distort(np.stack([columns, np.full(width, row + 0.5)], axis=1)) - 0.5
    return lookup[..., 0].copy(), lookup[..., 1].copy()


def _radial(x: Array, y: Array, coefficients: tuple[float, ...]) -> tuple[Array, Array]:
    """Brown-Conrady with the rational term, as in OpenCV's camera model."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (*coefficients, *([0.0] * 8))[:8]
    r2 = x * x + y * y
    scale = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    return (
        x * scale + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * scale + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


def _fisheye(x: Array, y: Array, coefficients: tuple[float, ...]) -> tuple[Array, Array]:
    """Kannala-Brandt: the image radius is a polynomial of the angle."""
    k1, k2, k3, k4 = (*coefficients, 0.0, 0.0, 0.0, 0.0)[:4]
    r = np.hypot(x, y)
    angle = np.arctan(r)
    a2 = angle * angle
    distorted = angle * (1 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))))
    scale = np.where(r > 1e-12, distorted / np.maximum(r, 1e-12), 1.0)
    return x * scale, y * scale


def _border(width: int, height: int) -> Array:
    t = np.linspace(0.0, 1.0, 65)
    zero, one = np.zeros_like(t), np.ones_like(t)
    unit = np.concatenate([np.stack(side, axis=1) for side in ((t, zero), (t, one), (zero, t), (one, t))])
    return unit * [width, height]


def _is_monotonic(lens: Lens, width: int, height: int) -> bool:
    """Whether the distorted radius grows along rays from the principal point; else the polynomial folds back."""
    centre = np.array(lens.pinhole[2:])
    steps = np.linspace(0.02, 1.0, 50)[:, None, None]
    rays = centre + steps * (_border(width, height)[None] - centre)
    distorted = lens.distort(rays.reshape(-1, 2)).reshape(rays.shape)
    if not np.isfinite(distorted).all():
        return False
    radius = np.linalg.norm((distorted - lens.intrinsics[2:]) / lens.intrinsics[:2], axis=2)
    reach = np.linalg.norm((rays - centre) / lens.pinhole[:2], axis=2)
    return bool((np.diff(radius, axis=0)[np.diff(reach, axis=0) > 1e-9] > 0).all())
