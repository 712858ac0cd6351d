"""How certain the maps of a fit are: standard errors of blocks of texels, and why blocks are uncertain.

Base colour, metalness (or ρs) and roughness of a block are estimated together, to first order around the fit, from
pixels of all training photographs. Their spread over groups of photographs is the error. It contains the noise, the
errors of cameras and mesh, and whatever a photograph shows that the model does not. Errors that all photographs have in
common are not in it: the scale between albedo and light (`light_scale.py`), and a wrong light.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Capture
from hir_core.mesh.texel_rasterization import texel_surface
from hir_core.plugins.interfaces import PreparedReflectance
from hir_core.scene import Scene
from hir_core.scene.map_errors import IN_SHADOW, OBSERVED, OUTSIDE, UNDER_HIGHLIGHTS, UNDER_OBSERVED, MapErrors
from hir_core.stages.reflectance.error_estimate.grouped_jackknife import NormalEquations, standard_errors
from hir_core.stages.reflectance.error_estimate.pixel_derivatives import (
    BASE_COLOR,
    METALNESS,
    ROUGHNESS,
    SPECULAR,
    PixelDerivatives,
    is_constant,
    pixel_derivatives,
)

MAX_PIXELS = 1 << 16
"""Pixels of all photographs together: some seconds."""
PIXELS_PER_BLOCK = 24
"""Mean over the blocks: the noise of a pixel matters little beside the errors that a photograph's pixels share."""
GROUPS = 16
"""Of photographs, one left out at a time; each holds photographs from all around the object."""
MIN_VIEWS = 6
HUBER_SRGB = 0.1
"""Residual from which a pixel weighs less, as in the fit."""
PRIOR_WIDTHS = {name: 1 / math.sqrt(12) for name in (BASE_COLOR, METALNESS, ROUGHNESS)} | {
    SPECULAR: 0.08 / math.sqrt(12)
}
"""Standard deviation of what is not known at all: a uniform distribution over 0…1, and over the F0 of dielectrics."""
LEAST_NOISE = 1e-4
"""Of residuals in sRGB: photographs have 256 levels or more."""
SHADOW_GAIN = 0.1
"""Of the light that the brightest tenth of the blocks receives: a block below it in all photographs lies in shadow."""
MAX_SPECULAR_SHARE = 0.5
"""A block that reflects more than this from its lobe in all photographs is seen under highlights alone."""


def estimated_map_errors(
    scene: Scene, prepared: PreparedReflectance, capture: Capture, downsample: int, seed: int
) -> MapErrors | None:
    """The errors of a fitted scene; None with fewer than `MIN_VIEWS` photographs or without texture coordinates.

    `prepared` shades the scene with all that was modelled, `capture` has the exposures of the fit applied.
    """
    views, material = len(capture.views), scene.material
    if views < MIN_VIEWS or scene.mesh.uvs is None or material is None:
        return None
    pixels = pixel_derivatives(scene, prepared, capture, downsample, max(1, MAX_PIXELS // views), seed)
    count = len(pixels.view)
    if not count:
        return None
    side = max(1, round(math.sqrt(count / PIXELS_PER_BLOCK / _covered_share(scene))))
    texels = texel_surface(scene.mesh, 4 * side).covered.cpu().numpy().reshape(side, 4, side, 4)
    covered = np.asarray(texels.any(axis=(1, 3)))
    if not covered.any():
        return None
    uv = np.clip(pixels.uv.cpu().numpy() * side, 0, side - 1).astype(np.int64)
    block = uv[:, 1] * side + uv[:, 0]
    group = pixels.view.cpu().numpy() % min(GROUPS, views)
    names = (BASE_COLOR, *pixels.names)
    shared = tuple(3 + i for i, name in enumerate(pixels.names) if is_constant(material, name))
    equations, noise = normal_equations(pixels, block, group, side * side, min(GROUPS, views))
    widths = np.array([PRIOR_WIDTHS[BASE_COLOR]] * 3 + [PRIOR_WIDTHS[name] for name in pixels.names])
    found = standard_errors(equations, shared, widths, noise)
    local = [name for i, name in enumerate(pixels.names) if 3 + i not in shared]

    def as_map(values: NDArray[np.float64]) -> NDArray[np.float32]:
        return np.where(covered, values.reshape(side, side), np.nan).astype(np.float32)

    base_color = np.stack([as_map(found.local[:, channel]) for channel in range(3)], axis=2)
    maps = {name: as_map(found.local[:, 3 + i]) for i, name in enumerate(local)}
    constants = {names[1 + each - 3]: float(found.shared[i]) for i, each in enumerate(shared)}
    seen = np.bincount(block, minlength=side * side).reshape(side, side)
    condition = _conditions(pixels, block, group, covered, base_color, seen)
    return MapErrors(base_color, maps, constants, condition)


def normal_equations(
    pixels: PixelDerivatives, block: NDArray[np.int64], group: NDArray[np.int64], blocks: int, groups: int
) -> tuple[NormalEquations, float]:
    """The equations of all blocks and groups, and the standard deviation of a residual (robust)."""
    from scipy.stats import median_abs_deviation

    residual, known = (each.double().cpu().numpy() for each in (pixels.residual, pixels.known))
    seen = residual[known > 0]
    noise = max(float(median_abs_deviation(seen, scale="normal")) if len(seen) else 0.0, LEAST_NOISE)
    weight = known / np.maximum(1, np.abs(residual) / HUBER_SRGB)
    own, others = pixels.base_color.double().cpu().numpy(), pixels.others.double().cpu().numpy()
    # rows of derivatives (P, parameters, channels): a channel of the base colour acts on that channel alone
    rows = np.concatenate([own[:, :, None] * np.eye(3), others], axis=1)
    count, place = rows.shape[1], group * blocks + block
    gradient = np.zeros((groups * blocks, count))
    hessian = np.zeros((groups * blocks, count, count))
    for i in range(count):
        gradient[:, i] = np.bincount(place, (weight * rows[:, i] * residual).sum(axis=1), groups * blocks)
        for j in range(i, count):
            product = (weight * rows[:, i] * rows[:, j]).sum(axis=1)
            hessian[:, i, j] = hessian[:, j, i] = np.bincount(place, product, groups * blocks)
    return NormalEquations(
        hessian.reshape(groups, blocks, count, count), gradient.reshape(groups, blocks, count)
    ), noise


def _conditions(
    pixels: PixelDerivatives,
    block: NDArray[np.int64],
    group: NDArray[np.int64],
    covered: NDArray[np.bool_],
    base_color: NDArray[np.float32],
    seen: NDArray[np.int64],
) -> NDArray[np.uint8]:
    """Why a block is uncertain: by the brightest and the least glossy of its groups of photographs."""
    blocks, groups = covered.size, int(group.max()) + 1
    place = group * blocks + block
    count = np.bincount(place, minlength=groups * blocks)
    known = count > 0

    def of_groups(values: NDArray[np.float64]) -> NDArray[np.float64]:
        mean = np.full(groups * blocks, np.nan)
        mean[known] = np.bincount(place, values, groups * blocks)[known] / count[known]
        return mean.reshape(groups, blocks)

    gain = of_groups(pixels.gain.mean(dim=1).double().cpu().numpy())
    share = of_groups(pixels.specular_share.double().cpu().numpy())
    brightest = np.nanmax(np.where(np.isnan(gain), -np.inf, gain), axis=0)
    least_glossy = np.nanmin(np.where(np.isnan(share), np.inf, share), axis=0)
    is_seen = seen.reshape(-1) > 0
    limit = SHADOW_GAIN * float(np.quantile(brightest[is_seen], 0.9)) if is_seen.any() else 0.0
    unknown = base_color.mean(axis=2).reshape(-1) >= 0.999 * PRIOR_WIDTHS[BASE_COLOR]
    condition = np.full(blocks, OBSERVED, np.uint8)
    condition[is_seen & (least_glossy > MAX_SPECULAR_SHARE)] = UNDER_HIGHLIGHTS
    condition[is_seen & (brightest < limit)] = IN_SHADOW
    condition[~is_seen | unknown] = UNDER_OBSERVED
    return np.where(covered, condition.reshape(covered.shape), OUTSIDE).astype(np.uint8)


def _covered_share(scene: Scene) -> float:
    return max(float(texel_surface(scene.mesh, 256).covered.float().mean()), 1e-3)
