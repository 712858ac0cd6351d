"""Signed distances to the outlines of masks, exact to a fraction of a pixel."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Array, Camera, Capture, View
from hir_core.errors import CaptureError

MIN_MASK_SHARE = 1e-5
"""A mask with a smaller mean is empty; one with a mean above 1 minus this has no background."""

_EXACT_BAND_PIXELS = 2.5
"""Distance from the outline, in pixels, within which distances to the subpixel contour are computed."""


@dataclass(frozen=True)
class SilhouetteField:
    """One view's mask as a signed distance in pixels, positive inside the object."""

    name: str
    camera: Camera
    """Has the resolution of `distance`."""
    distance: NDArray[np.float16]
    """(H, W)."""


def signed_distance(mask: NDArray[np.float32]) -> NDArray[np.float32]:
    """Distance (H, W) in pixels from each pixel's centre to the mask's 0.5 contour, positive inside.

    Near the contour it is exact for the antialiased mask; farther away it is that of the thresholded mask, within half
    a pixel. A mask without a contour gives plus or minus H + W everywhere.
    """
    import cv2
    from scipy.spatial import cKDTree
    from skimage.measure import find_contours

    inside = mask >= 0.5
    if inside.all() or not inside.any():
        return np.full(mask.shape, (1.0 if inside.any() else -1.0) * sum(mask.shape), dtype=np.float32)
    to_background = cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    to_object = cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    distance = np.where(inside, to_background - 0.5, 0.5 - to_object).astype(np.float32)
    contours = find_contours(mask, 0.5)
    if not contours:
        return distance
    steps = np.linspace(0.0, 1.0, 8, endpoint=False)[None, :, None]
    dense = [(c[:-1, None] * (1 - steps) + c[1:, None] * steps).reshape(-1, 2) for c in contours]
    near = np.argwhere(np.abs(distance) < _EXACT_BAND_PIXELS)
    exact, _ = cKDTree(np.concatenate(dense)).query(near)
    rows, columns = near.T
    distance[rows, columns] = np.where(inside[rows, columns], exact, -exact)
    return distance


def silhouette_fields(views: Sequence[View], downsample: int = 1) -> list[SilhouetteField]:
    """The fields of all views with a camera and a mask; masks without an outline are named in a warning."""
    fields: list[SilhouetteField] = []
    empty: list[str] = []
    for view in views:
        if view.camera is None:
            continue
        mask = view.pixels(downsample).mask
        if mask is None:
            continue
        if not MIN_MASK_SHARE < mask.mean() < 1 - MIN_MASK_SHARE:
            empty.append(view.name)
            continue
        distance = signed_distance(mask)
        fields.append(SilhouetteField(view.name, view.camera.downsampled(downsample), distance.astype(np.float16)))
    if empty:
        warnings.warn(
            f"{len(empty)} masks have no outline (all object or all background) and are not used for the hull: "
            f"{', '.join(empty[:5])}",
            stacklevel=2,
        )
    return fields


def working_downsample(capture: Capture, max_pixels: int = 96_000_000, max_side: int = 1600) -> int:
    """The smallest reduction factor at which all photographs together have at most `max_pixels` pixels."""
    cameras = [view.camera for view in capture.views if view.camera is not None]
    total = sum(c.width * c.height for c in cameras)
    side = max((max(c.width, c.height) for c in cameras), default=1)
    factor = 1
    while total > max_pixels * factor**2 or side > max_side * factor:
        factor += 1
    return factor


def focus_and_radius(fields: Sequence[SilhouetteField]) -> tuple[Array, float]:
    """Focus (3,) of the masks, and the radius of a sphere around it that covers most of them.

    The focus is the point nearest to the rays through the masks' centres (iteratively reweighted least squares).
    """
    origins, directions, extents = [], [], []
    for field in fields:
        rows, columns = np.nonzero(field.distance > 0)
        pixels = np.stack([columns, rows], axis=1) + 0.5
        centre = (pixels.min(axis=0) + pixels.max(axis=0)) / 2
        origin, direction = field.camera.rays(centre[None])
        origins.append(origin[0])
        directions.append(direction[0])
        reach = np.abs(pixels - centre).max(axis=0) + 1
        focal = (field.camera.intrinsics[0, 0], field.camera.intrinsics[1, 1])
        extents.append(float(np.hypot(reach[0] / focal[0], reach[1] / focal[1])))
    o, d = np.array(origins), np.array(directions)
    across = np.eye(3) - d[:, :, None] * d[:, None, :]
    camera_extent = float(np.linalg.norm(o - o.mean(axis=0), axis=1).max())
    if camera_extent == 0:
        raise CaptureError("all cameras are at one position; a visual hull needs photographs from several sides")
    weights = np.ones(len(o))
    focus = o.mean(axis=0)
    for _ in range(10):
        system = np.einsum("v,vij->ij", weights, across)
        # nearly parallel rays do not determine the depth: regularise it
        system = system + np.eye(3) * 1e-9 * weights.sum()
        focus = np.linalg.solve(system, np.einsum("v,vij,vj->i", weights, across, o) + 1e-9 * weights.sum() * focus)
        miss = np.linalg.norm(np.einsum("vij,vj->vi", across, focus - o), axis=1)
        weights = 1 / (1 + (miss / max(float(np.median(miss)), 1e-9 * camera_extent)) ** 2)
    depth = np.einsum("vj,vj->v", focus - o, d)
    ahead = depth > 1e-6 * camera_extent
    if not ahead.any():
        raise CaptureError(
            "the cameras look away from each other, so their masks have no common object; check the axes of the cameras"
        )
    tangents = np.minimum(np.array(extents), 2.0)
    # the near side of the sphere appears larger: r = t (z + r)
    radii = np.where(tangents < 0.9, tangents * depth / (1 - np.minimum(tangents, 0.9)), tangents * depth * 10)
    return focus, float(np.quantile(radii[ahead], 0.9))
