"""Mask source: GrabCut (Rother et al. 2004), initialised by reconstructed points, consistent by a visual hull."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from itertools import repeat
from typing import TYPE_CHECKING, final

import numpy as np
from hir_exporters.conventions import linear_to_srgb
from numpy.typing import NDArray

from hir_core.capture import Camera, Capture, Pixels
from hir_core.plugins.interfaces import MaskSource
from hir_plugins.masks.object_region import consistent_points, draw_discs, object_points
from hir_plugins.masks.options import GrabCutOptions

if TYPE_CHECKING:
    from hir_core.scene import Scene

_MAX_LINEAR_VALUE = 2.0
"""Linear values are clipped here before they are encoded."""


@final
class GrabCut(MaskSource):
    """GrabCut initialised by discs around the object's points, repeated inside the consistent region of all views."""

    def __init__(self, config: GrabCutOptions) -> None:
        self._config = config

    def masks(self, capture: Capture, scene: Scene | None) -> list[NDArray[np.float32] | None]:
        """One mask for each view. Captures without cameras or points raise `CaptureError`."""
        import cv2

        del scene
        points, center, radius = object_points(capture)
        factors = [self._factor(camera) for camera in capture.cameras]
        cameras = [camera.downsampled(f) for camera, f in zip(capture.cameras, factors, strict=True)]
        images = [_encoded_picture(v.pixels(f)) for v, f in zip(capture.views, factors, strict=True)]
        spacing = max(_typical_spacing(points), radius / 60)
        sure = [draw_discs(points, camera, 0.35 * spacing) for camera in cameras]
        # initial object pixels train the colour model: only as many as close the gaps between points
        likely = [draw_discs(points, camera, min(spacing, 0.5 * self._config.margin * radius)) for camera in cameras]
        outer = [draw_discs(points, camera, self._config.margin * radius) for camera in cameras]
        # OpenCV releases Python's lock during GrabCut and uses one core
        with ThreadPoolExecutor(max_workers=max(1, cv2.getNumThreads())) as pool:
            iterations, seed = repeat(self._config.iterations), repeat(self._config.seed)
            masks = list(pool.map(cut_by_colour, images, sure, likely, outer, iterations, seed))
            for _ in range(self._config.rounds):
                agreed, reach = consistent_points(masks, cameras, center, 1.6 * radius, self._config.agreement)
                regions = [draw_discs(agreed, camera, reach) for camera in cameras]
                masks = list(pool.map(_cut_again, images, sure, regions, iterations, seed))
        return [
            refine_edge(view.pixels().color_linear, mask, factor)
            for view, mask, factor in zip(capture.views, masks, factors, strict=True)
        ]

    def _factor(self, camera: Camera) -> int:
        return max(1, round(max(camera.width, camera.height) / self._config.max_image_size))


def cut_by_colour(
    image: NDArray[np.uint8],
    sure: NDArray[np.bool_],
    likely: NDArray[np.bool_],
    outer: NDArray[np.bool_],
    iterations: int,
    seed: int,
) -> NDArray[np.bool_]:
    """Object pixels (H, W) of an 8-bit image: all of `sure`, none outside `outer`, by colour in between.

    `likely` (H, W) are the initial object pixels.
    """
    import cv2

    labels = np.full(image.shape[:2], cv2.GC_BGD, np.uint8)
    labels[outer] = cv2.GC_PR_BGD
    labels[likely & outer] = cv2.GC_PR_FGD
    labels[sure] = cv2.GC_FGD
    object_seeds, background = (labels & 1) == 1, (labels & 1) == 0
    # the colour models need a few pixels of either kind
    if object_seeds.sum() < 50 or background.sum() < 50:
        return object_seeds
    cv2.setRNGSeed(seed)
    cv2.grabCut(image, labels, (0, 0, 1, 1), np.zeros((1, 65)), np.zeros((1, 65)), iterations, cv2.GC_INIT_WITH_MASK)
    return (labels & 1) == 1


def _cut_again(
    image: NDArray[np.uint8], sure: NDArray[np.bool_], region: NDArray[np.bool_], iterations: int, seed: int
) -> NDArray[np.bool_]:
    """Repeats the cut inside the consistent region, with a margin of 2 % of the image."""
    import cv2

    if not region.any():
        return region
    size = max(2, round(0.02 * max(region.shape)))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * size + 1, 2 * size + 1))
    solid = region.astype(np.uint8)
    inner, outer = cv2.erode(solid, kernel) > 0, cv2.dilate(solid, kernel) > 0
    # only the reconstructed points are certain: a hull also fills concavities. Its rim is initialised as background, or
    # the object's colour model would learn the background's colours
    return _largest_component(cut_by_colour(image, sure & inner, inner, outer, iterations, seed))


def refine_edge(color_linear: NDArray[np.float32], mask: NDArray[np.bool_], factor: int) -> NDArray[np.float32]:
    """The mask (H, W) at the photograph's full resolution; its edge follows the image (guided filter, He 2010)."""
    import cv2

    height, width = color_linear.shape[:2]
    grown = np.repeat(np.repeat(mask.astype(np.float32), factor, axis=0), factor, axis=1)
    large = np.pad(grown, ((0, height - grown.shape[0]), (0, width - grown.shape[1])), mode="edge")
    guide = np.asarray(linear_to_srgb(np.clip(color_linear, 0, 1)).mean(axis=2), dtype=np.float32)
    window = (2 * (2 * factor) + 1,) * 2
    mean_guide, mean_mask = cv2.blur(guide, window), cv2.blur(large, window)
    covariance = cv2.blur(guide * large, window) - mean_guide * mean_mask
    slope = covariance / (cv2.blur(guide * guide, window) - mean_guide**2 + 1e-4)
    offset = mean_mask - slope * mean_guide
    soft = cv2.blur(slope, window) * guide + cv2.blur(offset, window)
    # sharpened: the filter blurs the edge over its window
    return np.clip((soft - 0.5) * 2 + 0.5, 0, 1).astype(np.float32)


def _encoded_picture(pixels: Pixels) -> NDArray[np.uint8]:
    encoded = linear_to_srgb(np.clip(pixels.color_linear, 0, _MAX_LINEAR_VALUE))
    return np.rint(np.clip(encoded, 0, 1) * 255).astype(np.uint8)


def _typical_spacing(points: NDArray[np.floating]) -> float:
    from scipy.spatial import cKDTree

    neighbours, _ = cKDTree(points).query(points, k=min(4, len(points)))
    return float(np.median(neighbours[:, -1]))


def _largest_component(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The largest component; its holes of less than a hundredth of its area are filled."""
    from scipy.ndimage import label

    components, count = label(mask)
    if count == 0:
        return mask
    largest = components == np.bincount(components.reshape(-1))[1:].argmax() + 1
    holes, count = label(~largest)
    sizes = np.bincount(holes.reshape(-1))
    small = np.nonzero(sizes < 0.01 * largest.sum())[0]
    return largest | np.isin(holes, small[small > 0])
