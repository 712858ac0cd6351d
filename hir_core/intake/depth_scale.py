"""The common factor between measured depths and the scale of the cameras, from masks alone; no mesh is needed.

Each ray through an outline touches the object. Where it does, another view that looks along the normal measures the
depth of the ray; elsewhere the surface lies behind the ray. So the ratio of the ray's depth to the measured one is
largest at the contact, and is the factor there, whatever the surface does between contours: hollows do not bias it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Array, Camera, Capture, View
from hir_core.capture.depth_samples import depth_noise, usable_depths
from hir_core.intake.outline_rays import OutlineRays, outline_rays

PRIOR_ERROR: Final = 0.02
"""Standard deviation of the factor before anything is known, about 1: depth sensors state errors of 1 to 2 % of the
distance. A factor that masks determine to 0.2 % is shrunk by a hundredth of its difference from 1."""

MAX_ERROR: Final = PRIOR_ERROR / 2
"""A factor with a larger standard error is not determined: depths stay as they are."""

MAX_CORRECTION: Final = 0.06
"""Three standard deviations of the prior: depths that differ more have another unit or another fault."""

MIN_RAYS: Final = 100
"""Fewer rays that touch measured surface do not determine a factor."""

MAX_VIEWS: Final = 48
"""So many views, evenly spaced, take part."""

_MIN_VIEWS = 4
_RAYS_PER_VIEW = 60
_STEPS = 96
"""Points along each ray."""

_MAX_SIDE = 800
"""Masks are reduced to at most so many pixels."""

_MAX_RATIO = 0.1
"""Depths that differ by more from a point of the ray are those of other parts of the object."""

_MIN_COSINE = 0.5
"""Between the normal of the tangent plane and the direction to the camera that measures: 60 degrees."""

_TOLERATED_VIEWS = 0.05
"""Share of the masks that may lie beside a point of the object's hull."""

_OUTLINE_ERROR = 0.25
"""Pixels by which all outlines together may lie too far out or in: they shift the factor, and more rays do not help."""

_RADIUS_MARGIN = 1.2
"""The rays are searched this far, in radii of the measured points about their median."""


@dataclass(frozen=True)
class DepthScale:
    """The factor that measured depths need to agree with cameras and masks."""

    factor: float
    """Depths are multiplied by it; 1 where it is not determined."""
    standard_error: float | None
    """With the error that noise and outlines cause in all rays together; None with fewer than `MIN_RAYS` rays."""
    rays: int
    """Rays of outlines that touch a measured surface."""
    sentence: str
    """For users; empty where the factor differs from 1 by less than its standard error."""


@dataclass(frozen=True, eq=False)
class _Observation:
    """A view at reduced resolution."""

    camera: Camera
    mask: NDArray[np.float32]
    depth_camera: Camera
    depth: NDArray[np.float32]
    """(H, W), 0 where it cannot be used."""


def with_depth_scale(capture: Capture, seed: int = 0) -> tuple[Capture, DepthScale | None]:
    """The capture with depths in the scale of its cameras, and the factor; None without depth maps.

    `seed` draws the rays of outlines.
    """
    if all(view.depth is None for view in capture.views):
        return capture, None
    scale = depth_scale(capture.views, seed)
    if scale.factor == 1:
        return capture, scale
    views = (v if v.depth is None else replace(v, depth=v.depth.scaled(scale.factor)) for v in capture.views)
    return replace(capture, views=tuple(views)), scale


def depth_scale(views: Sequence[View], seed: int = 0) -> DepthScale:
    """The factor, and 1 with the reason where views with cameras, masks and depths do not determine it."""
    seen = _observations(views)
    if len(seen) < _MIN_VIEWS:
        return _undetermined(0, None, f"only {len(seen)} photographs have a mask and depths")
    center, radius = _extent(seen)
    random = np.random.default_rng(seed)
    found = []
    for i, view in enumerate(seen):
        rays = outline_rays(view.camera, view.mask, _RAYS_PER_VIEW, random)
        found.append(_contact_ratios(rays, i, seen, center, radius))
    ratios = np.concatenate(found)
    if len(ratios) < MIN_RAYS:
        reason = f"only {len(ratios)} rays of outlines meet a measured surface within {_MAX_RATIO:.0%} of their depth"
        return _undetermined(len(ratios), None, reason)
    ratio, error = float(np.median(ratios.mean(axis=1))), _standard_error(found, seen)
    if error > MAX_ERROR:
        return _undetermined(len(ratios), error, f"masks determine them to {error:.1%} only")
    if abs(ratio - 1) > MAX_CORRECTION:
        return _undetermined(
            len(ratios),
            error,
            f"a difference of {1 / ratio - 1:+.1%} is more than a sensor's error: check the unit of the depths, or "
            "take the depth maps out of the capture",
        )
    trust = PRIOR_ERROR**2 / (PRIOR_ERROR**2 + error**2)
    factor, error = 1 + trust * (ratio - 1), error * math.sqrt(trust)
    difference = 1 / factor - 1
    notable = abs(factor - 1) > error
    word = "longer" if difference > 0 else "shorter"
    sentence = (
        f"measured depths are {abs(difference):.2%} {word} than the scale of the cameras says (± {error:.2%}); they "
        "are corrected"
    )
    return DepthScale(factor, error, len(ratios), sentence if notable else "")


def _undetermined(rays: int, error: float | None, reason: str) -> DepthScale:
    return DepthScale(1.0, error, rays, f"the scale of measured depths is not checked against the cameras: {reason}")


def _standard_error(ratios: Sequence[Array], seen: Sequence[_Observation]) -> float:
    """From the spread over views, the interval between both estimates of a ray, and the position of outlines.

    The larger one of two estimates is too large, the smaller one too small, so the truth is anywhere between them.
    """
    medians = np.array([np.median(each.mean(axis=1)) for each in ratios if len(each)])
    between_views = float(medians.std(ddof=1)) / math.sqrt(len(medians)) if len(medians) > 1 else math.inf
    high, low = np.median(np.concatenate(ratios), axis=0)
    focal = float(np.median([view.camera.intrinsics[0, 0] for view in seen]))
    return math.hypot(between_views, abs(high - low) / math.sqrt(12), _OUTLINE_ERROR / focal)


def _observations(views: Sequence[View]) -> list[_Observation]:
    usable = [view for view in views if view.camera is not None and view.depth is not None]
    chosen = np.unique(np.linspace(0, len(usable) - 1, min(len(usable), MAX_VIEWS)).round().astype(int))
    found = []
    for view in (usable[i] for i in chosen):
        measured = view.measured_depth()
        assert measured is not None and view.camera is not None
        factor = max(1, math.ceil(max(view.camera.width, view.camera.height) / _MAX_SIDE))
        mask = view.pixels(factor).mask
        if mask is None:
            continue
        camera, pixels = measured
        kept = usable_depths(camera, pixels, depth_noise(pixels))
        depth = np.where(kept, pixels.depth, np.float32(0))
        found.append(_Observation(view.camera.downsampled(factor), mask, camera, depth))
    return found


def _extent(seen: Sequence[_Observation]) -> tuple[Array, float]:
    """A ball (centre, radius) that contains the measured points of the object."""
    points = []
    for view in seen:
        rows, columns = np.nonzero(view.depth)
        pixels = np.stack([columns, rows], axis=1) + 0.5
        scale = np.array([view.camera.width / view.depth_camera.width, view.camera.height / view.depth_camera.height])
        inside = _bilinear(view.mask, pixels * scale) > 0.5
        origins, directions = view.depth_camera.rays(pixels[inside])
        length = view.depth[rows, columns][inside] / (directions @ view.depth_camera.world_to_camera[2, :3])
        points.append(origins + directions * length[:, None])
    every = np.concatenate(points)
    if not len(every):
        return np.zeros(3), 0.0
    center = np.median(every, axis=0)
    return center, _RADIUS_MARGIN * float(np.percentile(np.linalg.norm(every - center, axis=1), 99))


def _contact_ratios(rays: OutlineRays, own: int, seen: Sequence[_Observation], center: Array, radius: float) -> Array:
    """(M, 2): of each ray that touches a measured surface, two estimates of the depth of the ray over the measured one.

    The first is the largest ratio along the ray, which noise increases. The second takes the place of the largest ratio
    from one half of the views and the ratio there from the other half, which noise of the place decreases.
    """
    middle = ((center - rays.origins) * rays.directions).sum(axis=1)
    along = middle[:, None] + np.linspace(-radius, radius, _STEPS)
    points = rays.origins[:, None] + rays.directions[:, None] * along[..., None]
    flat, shape, normals = points.reshape(-1, 3), along.shape, np.repeat(rays.normals, _STEPS, axis=0)
    beside = np.zeros(shape, dtype=np.int64)
    total, weight = np.zeros((2, *shape)), np.zeros((2, *shape))
    for i, view in enumerate(seen):
        if i == own:
            continue
        at, ahead = view.camera.project(flat)
        # what the frame does not show may be object
        outside = (_bilinear(view.mask, at, beyond=1.0) < 0.25) & (ahead > 0)
        beside += outside.reshape(shape)
        toward = view.camera.center - flat
        cosine = (toward * normals).sum(axis=1) / np.linalg.norm(toward, axis=1)
        facing = np.flatnonzero(cosine > _MIN_COSINE)
        at, depth = view.depth_camera.project(flat[facing])
        known = _bilinear((view.depth > 0).astype(np.float32), at) > 0.999
        ratio = depth / np.where(known, np.maximum(_bilinear(view.depth, at), 1e-12), np.inf)
        near = np.abs(ratio - 1) < _MAX_RATIO
        counted = facing[near]
        total[i % 2].reshape(-1)[counted] += ratio[near] * cosine[counted]
        weight[i % 2].reshape(-1)[counted] += cosine[counted]
    weight *= beside <= int(_TOLERATED_VIEWS * len(seen))
    both = np.asarray((weight > 0).all(axis=0))
    touching = both.any(axis=1)
    total, weight, both = total[:, touching], weight[:, touching], both[touching]
    half = np.where(both, total / np.maximum(weight, 1e-12), -np.inf)
    whole = np.where(both, total.sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-12), -np.inf)
    line = np.arange(len(both))
    crossed = (half[1][line, half[0].argmax(axis=1)] + half[0][line, half[1].argmax(axis=1)]) / 2
    return np.stack([whole.max(axis=1), crossed], axis=1)


def _bilinear(image: NDArray[np.float32], pixels: Array, beyond: float = 0.0) -> Array:
    """Values (N,) of an image (H, W) at pixels (N, 2); `beyond` outside of it."""
    from scipy.ndimage import map_coordinates

    at = [pixels[:, 1] - 0.5, pixels[:, 0] - 0.5]
    return np.asarray(map_coordinates(image, at, order=1, mode="constant", cval=beyond))
