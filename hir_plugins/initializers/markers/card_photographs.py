"""The irradiance that photographs of the grey card show: π × colour / reflectance of its patches."""

from __future__ import annotations

import warnings
from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Array, Camera, Capture, View
from hir_core.capture.measured_irradiance import MeasuredIrradiance
from hir_plugins.initializers.markers.grey_card import (
    MARKERS,
    PATCH_GREYS,
    PATCHES,
    corners_on_card,
    patch_points,
)
from hir_plugins.initializers.markers.marker_geometry import Corners

MIN_CARD_MARKERS = 3
"""Of four: fewer do not show whether the card is flat."""
MAX_BEND = 0.05
"""Distance of a corner from where a flat card has it, in sides of a marker."""
POINTS, INSET = 9, 0.2
"""Samples along a side of a patch, and the border that is left out, as a fraction of its side: lenses blur edges."""
BLOCKS = 3
"""Along a side of a patch; means over a block have less noise than samples."""
MIN_PATCH_PIXELS = 6.0
"""Shortest side of a patch in a photograph."""
MIN_COSINE = 0.35
"""Between the card's normal and the direction to the camera: at grazing angles paper is glossy."""
MAX_UNEVENNESS = 0.1
"""Standard deviation over the mean of a patch's blocks: more is a shadow's edge, gloss, or something in front."""
MAX_OBJECT_COVERAGE = 0.01
DARKEST = 1e-4
"""Linear colours below are noise."""


def measured_irradiance(
    capture: Capture, corners: Mapping[int, Corners], paper_reflectance: float
) -> MeasuredIrradiance | None:
    """What arrives at the card whose markers have these corners in the world; None where it is not seen well enough.

    Bare paper has the given reflectance. That of the printed greys is measured beside it, in photographs where neither
    is clipped; so a photograph whose paper is clipped counts too.
    """
    world_from_card = _pose(corners)
    if world_from_card is None:
        return None
    normal = np.cross(world_from_card[:, 1], world_from_card[:, 0])
    normal /= np.linalg.norm(normal)
    seen = np.array([_patch_colors(view, world_from_card, normal) for view in capture.views])  # (views, patches, 3)
    reflectance = _reflectances(seen, paper_reflectance)
    if reflectance is None:
        warnings.warn(
            "the paper of the card is clipped, hidden or too small in all photographs, so it says nothing about the "
            "light: expose less, and lay it where most photographs show it",
            stacklevel=2,
        )
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of photographs without a patch
        found = np.pi * np.nanmedian(seen / reflectance, axis=1)
    values = {
        view.name: (float(color[0]), float(color[1]), float(color[2]))
        for view, color in zip(capture.views, found / np.array([v.gain for v in capture.views]), strict=True)
        if np.isfinite(color).all()
    }
    return MeasuredIrradiance((float(normal[0]), float(normal[1]), float(normal[2])), values) if values else None


def _pose(corners: Mapping[int, Corners]) -> Array | None:
    """3×3: (x, y, 1) on the card in sides of a marker, to the world; None where no flat card explains the corners."""
    seen = [number for number in MARKERS if number in corners]
    if len(seen) < MIN_CARD_MARKERS:
        return None
    flat = np.concatenate([corners_on_card(number) for number in seen])
    world = np.concatenate([corners[number] for number in seen])
    on_card = np.column_stack([flat, np.ones(len(flat))])
    solution = np.linalg.lstsq(on_card, world, rcond=None)[0]
    side = np.linalg.norm(solution[:2], axis=1).mean()
    if not side > 0 or np.linalg.norm(on_card @ solution - world, axis=1).max() > MAX_BEND * side:
        return None
    return np.asarray(solution.T)


def _patch_colors(view: View, world_from_card: Array, normal: Array) -> Array:
    """Linear colour (patches, 3) of each patch in a photograph; NaN where it is not seen well."""
    found = np.full((len(PATCHES), 3), np.nan)
    camera = view.camera
    if camera is None:
        return found
    toward = camera.center - world_from_card @ np.array([0.0, 0.0, 1.0])
    if toward @ normal < MIN_COSINE * np.linalg.norm(toward):
        return found
    pixels = view.pixels()
    for patch in range(len(PATCHES)):
        at = _projected(camera, world_from_card, patch_points(patch, POINTS, INSET))
        if at is None or _shortest_side(at) < MIN_PATCH_PIXELS:
            continue
        hidden = pixels.mask is not None and _sampled(pixels.mask, at).max() > MAX_OBJECT_COVERAGE
        if hidden or _sampled(pixels.saturated.astype(np.float32), at).max() > 0:
            continue
        color = _sampled(pixels.color_linear, at)
        blocks = color.reshape(BLOCKS, POINTS // BLOCKS, BLOCKS, POINTS // BLOCKS, 3).mean(axis=(1, 3)).reshape(-1, 3)
        mean = blocks.mean(axis=0)
        if (mean > DARKEST).all() and (blocks.std(axis=0) < MAX_UNEVENNESS * mean).all():
            found[patch] = np.median(blocks, axis=0)
    return found


def _reflectances(seen: Array, paper: float) -> Array | None:
    """Of each patch and channel (patches, 3), from the photographs' ratios to the paper; NaN for a grey that no
    photograph shows beside it, None without paper.
    """
    greys = np.array(PATCH_GREYS)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        of_grey = {grey: np.nanmean(seen[:, greys == grey], axis=1) for grey in np.unique(greys)}  # (views, 3) each
        white = of_grey[255]
        if not np.isfinite(white).any():
            return None
        ratio = {grey: np.nanmedian(color / white, axis=0) for grey, color in of_grey.items()}
    return paper * np.array([ratio[grey] for grey in PATCH_GREYS])


def _projected(camera: Camera, world_from_card: Array, points: Array) -> Array | None:
    """Pixels (N, 2) of points of the card; None where one is behind the camera or outside the photograph."""
    world = np.column_stack([points, np.ones(len(points))]) @ world_from_card.T
    at, depth = camera.project(world)
    inside = (at > 0.5).all() and (at < [camera.width - 0.5, camera.height - 0.5]).all()
    return at if (depth > 0).all() and inside else None


def _shortest_side(at: Array) -> float:
    """Of a patch in pixels, from its grid of samples."""
    grid = at.reshape(POINTS, POINTS, 2)
    sides = np.linalg.norm(grid[0, -1] - grid[0, 0]), np.linalg.norm(grid[-1, 0] - grid[0, 0])
    return float(min(sides)) / (1 - 2 * INSET)


def _sampled(image: NDArray[np.float32], at: Array) -> Array:
    """Bilinear values at pixel positions whose centres are at ½."""
    position = (at - 0.5).astype(np.float32)
    sampled = cv2.remap(image, position[:, None, 0], position[:, None, 1], cv2.INTER_LINEAR)
    return np.asarray(sampled[:, 0], dtype=np.float64)
