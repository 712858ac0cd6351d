"""The irradiance that photographs of the grey card show: π × colour / reflectance of its patches."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence

import numpy as np

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
from hir_plugins.initializers.markers.patch_colors import INSET, MIN_COSINE, POINTS, patch_color

MIN_CARD_MARKERS = 3
"""Of four: fewer do not show whether the card is flat."""
MAX_BEND = 0.05
"""Distance of a corner from where a flat card has it, in sides of a marker."""


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
    return irradiance_of_patches(capture.views, seen, reflectance, normal)


def irradiance_of_patches(
    views: Sequence[View], seen: Array, reflectance: Array, normal: Array
) -> MeasuredIrradiance | None:
    """π × colour / reflectance, the median over the patches of each photograph; None where none shows a patch.

    `seen`: linear colours (views, patches, 3), NaN where a patch is not seen well. `reflectance`: (patches, 3), NaN for
    an unknown one. `normal`: of the card in the world, on its printed side.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of photographs without a patch
        found = np.pi * np.nanmedian(seen / reflectance, axis=1)
    values = {
        view.name: (float(color[0]), float(color[1]), float(color[2]))
        for view, color in zip(views, found / np.array([v.gain for v in views]), strict=True)
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
        if at is not None and (color := patch_color(pixels, at)) is not None:
            found[patch] = color
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
