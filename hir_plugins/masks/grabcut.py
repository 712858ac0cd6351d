"""Masks by GrabCut (Rother et al. 2004), seeded by the reconstruction and made consistent by a visual hull."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, final

import numpy as np
from hir_exporters.conventions import linear_to_srgb
from numpy.typing import NDArray

from hir_core.capture import Camera, Capture, Pixels
from hir_core.plugins.interfaces import MaskSource
from hir_plugins.masks.object_region import consistent_silhouettes, draw_discs, object_points
from hir_plugins.masks.options import GrabCutOptions

if TYPE_CHECKING:
    from hir_core.scene import Scene

_MAX_LINEAR_VALUE = 2.0
"""Linear values are compared up to this."""


@final
class GrabCut(MaskSource):
    """Starts from discs around the object's points and cuts by colour; then only what views agree on is cut again."""

    def __init__(self, config: GrabCutOptions) -> None:
        self._config = config

    def masks(self, capture: Capture, scene: Scene | None) -> list[NDArray[np.float32] | None]:
        """One mask for each view; captures without cameras or points are a `CaptureError`."""
        import cv2

        del scene
        points, center, radius = object_points(capture)
        factors = [self._factor(camera) for camera in capture.cameras]
        cameras = [camera.downsampled(f) for camera, f in zip(capture.cameras, factors, strict=True)]
        images = [_encoded_picture(v.pixels(f)) for v, f in zip(capture.views, factors, strict=True)]
        spacing = max(_typical_spacing(points), radius / 60)
        sure = [draw_discs(points, camera, 0.35 * spacing) for camera in cameras]
        # what starts as object teaches its colours: no more than closes the gaps between points
        likely = [draw_discs(points, camera, min(spacing, 0.5 * self._config.margin * radius)) for camera in cameras]
        outer = [draw_discs(points, camera, self._config.margin * radius) for camera in cameras]
        # OpenCV lets go of the interpreter while it cuts, and cuts on one core
        with ThreadPoolExecutor(max_workers=max(1, cv2.getNumThreads())) as pool:
            masks = list(pool.map(cut_by_colour, images, sure, likely, outer))
            for _ in range(self._config.rounds):
                body = consistent_silhouettes(masks, cameras, center, 1.6 * radius, self._config.agreement)
                masks = list(pool.map(_cut_again, images, sure, body))
        return [
            refine_edge(view.pixels().color_linear, mask, factor)
            for view, mask, factor in zip(capture.views, masks, factors, strict=True)
        ]

    def _factor(self, camera: Camera) -> int:
        return max(1, round(max(camera.width, camera.height) / self._config.max_image_size))


def cut_by_colour(
    image: NDArray[np.uint8], sure: NDArray[np.bool_], likely: NDArray[np.bool_], outer: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Object pixels (H, W) of an 8-bit picture: all of `sure`, nothing outside of `outer`, colours decide between."""
    import cv2

    labels = np.full(image.shape[:2], cv2.GC_BGD, np.uint8)
    labels[outer] = cv2.GC_PR_BGD
    labels[likely & outer] = cv2.GC_PR_FGD
    labels[sure] = cv2.GC_FGD
    object_seeds, background = (labels & 1) == 1, (labels & 1) == 0
    # the colour models need a few pixels of either kind
    if object_seeds.sum() < 50 or background.sum() < 50:
        return object_seeds
    cv2.setRNGSeed(0)
    cv2.grabCut(image, labels, (0, 0, 1, 1), np.zeros((1, 65)), np.zeros((1, 65)), 4, cv2.GC_INIT_WITH_MASK)
    return (labels & 1) == 1


def _cut_again(image: NDArray[np.uint8], sure: NDArray[np.bool_], region: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Cuts inside of the region that the views agree on, and a little beyond it."""
    import cv2

    if not region.any():
        return region
    size = max(2, round(0.02 * max(region.shape)))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * size + 1, 2 * size + 1))
    solid = region.astype(np.uint8)
    inner, outer = cv2.erode(solid, kernel) > 0, cv2.dilate(solid, kernel) > 0
    # only the reconstructed points are sure: a hull also fills what lies between jaw and neck. Its rim starts as
    # background, or the colours of the background beside the object would be learnt as the object's
    return _largest_component(cut_by_colour(image, sure & inner, inner, outer))


def refine_edge(color_linear: NDArray[np.float32], mask: NDArray[np.bool_], factor: int) -> NDArray[np.float32]:
    """The small mask at the picture's full size, its edge drawn to the picture's (guided filter, He 2010)."""
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
    # sharpened: the filter alone leaves a veil as wide as its window
    return np.clip((soft - 0.5) * 2 + 0.5, 0, 1).astype(np.float32)


def _encoded_picture(pixels: Pixels) -> NDArray[np.uint8]:
    encoded = linear_to_srgb(np.clip(pixels.color_linear, 0, _MAX_LINEAR_VALUE))
    return np.rint(np.clip(encoded, 0, 1) * 255).astype(np.uint8)


def _typical_spacing(points: NDArray[np.floating]) -> float:
    from scipy.spatial import cKDTree

    neighbours, _ = cKDTree(points).query(points, k=min(4, len(points)))
    return float(np.median(neighbours[:, -1]))


def _largest_component(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The largest piece without its holes smaller than itself by a hundred times."""
    from scipy.ndimage import label

    pieces, count = label(mask)
    if count == 0:
        return mask
    kept = pieces == np.bincount(pieces.reshape(-1))[1:].argmax() + 1
    holes, count = label(~kept)
    sizes = np.bincount(holes.reshape(-1))
    small = np.nonzero(sizes < 0.01 * kept.sum())[0]
    return kept | np.isin(holes, small[small > 0])
