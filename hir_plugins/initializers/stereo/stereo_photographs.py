"""Photographs for stereo: cropped to the object, at several resolutions, with the depth of surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from hir_exporters.conventions import linear_to_srgb
from numpy.typing import NDArray

from hir_core.capture import Array, Camera, View
from hir_plugins.initializers.stereo.surface_sweep import SweptView
from hir_plugins.initializers.surface.swept_surface import SweptSurface

_CROP_MARGIN_PIXELS = 16
"""Pixels around the object that remain after the crop: windows extend beyond its outline."""


@dataclass(frozen=True)
class StereoPhotograph:
    """A photograph cropped to the object; its sides are multiples of the largest reduction factor."""

    camera: Camera
    brightness: NDArray[np.float32]
    """(H, W), sRGB, black outside the object."""
    color_linear: NDArray[np.float32]
    """(H, W, 3)."""
    inside: NDArray[np.float32]
    """(H, W), coverage of the object."""
    clipped: NDArray[np.float32]
    """(H, W), 1 at clipped pixels."""

    def at_level(self, factor: int, front: SweptSurface, bound: SweptSurface, device: str) -> SweptView:
        """The photograph reduced by `factor`, with the inverse depths of both surfaces."""
        camera = self.camera.downsampled(factor)
        inside, clipped = _reduced(self.inside, factor), _reduced(self.clipped, factor)
        inverse = front.inverse_depth(camera)
        return SweptView(
            camera,
            torch.from_numpy(_reduced(self.brightness, factor)).to(device),
            torch.from_numpy(inside > 0.5).to(device),
            torch.from_numpy((inside > 0.5) & (clipped == 0)).to(device),
            torch.from_numpy(inverse).to(device),
            torch.from_numpy(inverse if bound is front else bound.inverse_depth(camera)).to(device),
        )


def crop_to_object(view: View, shrink: int, multiple: int, center: Array, radius: float) -> StereoPhotograph | None:
    """A view reduced by `shrink` and cropped to its mask, else to a sphere; None if the object is not in the image."""
    assert view.camera is not None
    pixels = view.pixels(shrink)
    camera = view.camera.downsampled(shrink)
    brightness = linear_to_srgb(np.clip(pixels.color_linear.mean(axis=2), 0, 1)).astype(np.float32)
    inside = _sphere_mask(camera, center, radius) if pixels.mask is None else pixels.mask
    if pixels.mask is not None:
        # the background must not be matched: it is static behind a turntable, and black in renders
        brightness = brightness * pixels.mask
    rows, columns = np.nonzero((inside > 0.5).any(axis=1))[0], np.nonzero((inside > 0.5).any(axis=0))[0]
    if not len(rows):
        return None
    (top, bottom), (left, right) = (
        _crop_range(int(used[0]), int(used[-1]) + 1, size, multiple)
        for used, size in ((rows, camera.height), (columns, camera.width))
    )
    part = (slice(top, bottom), slice(left, right))
    intrinsics = np.array([[1, 0, -left], [0, 1, -top], [0, 0, 1.0]]) @ camera.intrinsics
    camera = replace(camera, intrinsics=intrinsics, width=right - left, height=bottom - top)
    clipped = pixels.saturated.astype(np.float32)
    return StereoPhotograph(camera, brightness[part], pixels.color_linear[part], inside[part], clipped[part])


def choose_neighbours(
    cameras: Sequence[Camera], center: Array, count: int, takes: Sequence[int] = ()
) -> list[list[int]]:
    """For each camera at most `count` others whose directions to the object differ by about 10°, the best first.

    `takes` has the number of each photograph's take; with it, only photographs of one take are neighbours.
    """
    toward = directions_from(cameras, center)
    angle = np.degrees(np.arccos(np.clip(toward @ toward.T, -1, 1)))
    # a small baseline is inaccurate, a large one changes the appearance: a ratio of 2 either way costs the same
    cost = np.abs(np.log(np.maximum(angle, 0.5) / 10.0))
    cost[angle < 1.5] = np.inf
    cost[angle > 50] = np.inf
    np.fill_diagonal(cost, np.inf)
    if len(takes):
        cost[~same_take(takes)] = np.inf
    return [[int(j) for j in np.argsort(row, kind="stable")[:count] if np.isfinite(row[j])] for row in cost]


def same_take(takes: Sequence[int]) -> NDArray[np.bool_]:
    """Which photographs (N, N) are of one take; another take shows a surface point under another light."""
    number = np.asarray(takes)
    return np.asarray(number[:, None] == number[None, :])


def directions_from(cameras: Sequence[Camera], center: Array) -> Array:
    """Unit vectors (N, 3) from `center` to the cameras."""
    toward = np.array([camera.center - center for camera in cameras])
    return np.asarray(toward / np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-30))


def evenly_distributed_views(
    cameras: Sequence[Camera], center: Array, count: int, takes: Sequence[int] = ()
) -> list[int]:
    """At most `count` cameras, in their order, whose directions cover the others': each one added is the farthest from
    those before it.

    Each take has a share of them in proportion to its photographs, chosen by itself: only these are compared.
    """
    if len(cameras) <= count:
        return list(range(len(cameras)))
    toward = directions_from(cameras, center)
    if len(set(takes)) <= 1:
        return _farthest_directions(toward, count)
    members = [np.flatnonzero(np.asarray(takes) == take) for take in dict.fromkeys(takes)]
    exact = [count * len(own) / len(cameras) for own in members]
    shares = [int(share) for share in exact]
    # largest remainder
    for each in sorted(range(len(members)), key=lambda i: shares[i] - exact[i])[: count - sum(shares)]:
        shares[each] += 1
    chosen = (own[_farthest_directions(toward[own], n)] for own, n in zip(members, shares, strict=True) if n)
    return sorted(int(i) for part in chosen for i in part)


def _farthest_directions(toward: Array, count: int) -> list[int]:
    """Indices of `count` of the directions (N, 3), in their order."""
    chosen, nearest = [0], toward @ toward[0]
    while len(chosen) < count:
        farthest = int(nearest.argmin())
        chosen.append(farthest)
        nearest = np.maximum(nearest, toward @ toward[farthest])
    return sorted(chosen)


def _sphere_mask(camera: Camera, center: Array, radius: float) -> NDArray[np.float32]:
    pixel, depth = camera.project(center[None])
    reach = radius * camera.intrinsics[0, 0] / max(float(depth[0]), 1e-9)
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
    return (np.hypot(columns - pixel[0, 0], rows - pixel[0, 1]) < reach).astype(np.float32)


def _crop_range(first: int, last: int, size: int, multiple: int) -> tuple[int, int]:
    """The range `first`…`last` with a margin, extended to a multiple of `multiple` as far as the image allows."""
    low = max(first - _CROP_MARGIN_PIXELS, 0)
    length = -(-(min(last + _CROP_MARGIN_PIXELS, size) - low) // multiple) * multiple
    if low + length > size:
        low = max(size - length, 0)
        length = (size - low) // multiple * multiple
    return low, low + length


def _reduced(image: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    height, width = image.shape
    return np.ascontiguousarray(image.reshape(height // factor, factor, width // factor, factor).mean(axis=(1, 3)))
