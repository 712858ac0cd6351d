"""Path tracing after a fast fit, kept only where held-out views gain (DESIGN section 7).

Either the albedo in closed form under what it shows, or a short run of gradient steps.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hir_core.capture import Capture
from hir_core.config import ReflectanceSettings
from hir_core.optimization.weighted_energies import Energies
from hir_core.rendering.reference_renderer import reference_renderer
from hir_core.scene import Scene
from hir_core.scene.srgb import linear_to_srgb
from hir_core.stages.reflectance.gradient_fit import ObjectPixels, fit_by_gradient, object_pixels
from hir_core.stages.reflectance.model_selection import SIGNIFICANCE, compare, decibels, split_views

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import PreparedReflectance, ReflectanceRenderer, ReflectanceSolver
    from hir_core.run.stage_context import StageContext

JUDGED_PIXELS = 4096
"""Pixels of each held-out view that are compared, the same before and after."""
PASSES = 8
"""Independent renderings that are averaged for that: the tracer's noise would weigh on both sides."""
PATHS = 32
"""Through each pixel that an albedo is solved from in closed form: some five pixels a texel average their noise."""


def polished(
    scene: Scene, capture: Capture, settings: ReflectanceSettings, energies: Energies, context: StageContext
) -> tuple[Scene, dict[str, Any]]:
    """The scene after `polish_iterations` steps through `polish_renderer`, or as it was where views do not gain.

    The steps see the training part of the views alone. The report holds the mean held-out PSNR before and after, the
    gain and its standard error. Too few views to judge by leave the scene as it was, with a warning.
    """
    training, held_out = split_views(len(capture.views))
    if not held_out:
        context.warn("too few views to judge a polish by: it was left out")
        return scene, {"kept": False, "held_out_views": 0}
    began = time.perf_counter()
    options = context.options.get("reflectance_renderer", {}).get(settings.polish_renderer, {})
    renderer: ReflectanceRenderer = context.plugins.create("reflectance_renderer", settings.polish_renderer, options)
    prepared = renderer.prepare(scene, capture, settings.downsample)
    device = str(scene.mesh.positions.device)
    judged = [object_pixels(capture, [view], settings.downsample, device) for view in held_out]
    before = view_errors(scene, prepared, judged, context.seed)
    steps = replace(settings, learning_rate=settings.polish_rate, learning_rate_end=0.1, batch="pixels")
    assert scene.material is not None
    fitted, _ = fit_by_gradient(
        scene,
        prepared,
        object_pixels(capture, training, settings.downsample, device),
        steps,
        energies,
        context,
        steps=settings.polish_iterations,
        fit_light=not settings.known_environment,
        fit_specular=bool((scene.material.specular_albedo > 0).any()),
    )
    after = view_errors(fitted, prepared, judged, context.seed)
    gain, noise = compare(before, after)
    kept = bool(gain > SIGNIFICANCE * noise)
    report = {
        "renderer": settings.polish_renderer,
        "steps": settings.polish_iterations,
        "held_out_views": len(held_out),
        "before_db": round(float(np.mean(decibels(before))), 3),
        "after_db": round(float(np.mean(decibels(after))), 3),
        "gain_db": round(gain, 3),
        "noise_db": round(noise, 3),
        "kept": kept,
    }
    if not kept:
        context.warn(
            f"path tracing for {time.perf_counter() - began:.0f} s brought held-out views {gain:+.2f} ± "
            f"{noise:.2f} dB: the result without it is kept"
        )
    return fitted if kept else scene, report


def settled(
    scene: Scene,
    solver: ReflectanceSolver,
    capture: Capture,
    settings: ReflectanceSettings,
    bounces: int,
    context: StageContext,
    report: Callable[[float], None] = lambda share: None,
) -> tuple[Scene, dict[str, Any]]:
    """The scene with the albedo that path tracing asks for, or as it was where held-out views do not gain.

    They judge two albedos that are solved for the other views, with path tracing and without; the one that is kept is
    solved for all. The report holds the mean held-out PSNR of both, the gain and its standard error.
    """
    report(0.0)
    training, held_out = split_views(len(capture.views))
    if not held_out:
        return scene, {"kept": False, "held_out_views": 0}
    options = dict(context.options.get("reflectance_renderer", {}).get(settings.polish_renderer, {}))
    config = context.plugins.find("reflectance_renderer", settings.polish_renderer).component.config
    if "samples" in getattr(config, "__dataclass_fields__", {}):
        options.setdefault("samples", PATHS)
    _, renderer = reference_renderer(context.plugins, settings.polish_renderer, options, bounces)
    traced = renderer.prepare(scene, capture, settings.downsample)
    without = solver.settle(scene, None, training, lambda share: None)
    tried = solver.settle(scene, traced, training, lambda share: report(0.75 * share))
    if without is None or tried is None:
        return scene, {"kept": False, "reason": "the solver has no closed form for it"}
    device = str(scene.mesh.positions.device)
    judged = [object_pixels(capture, [view], settings.downsample, device) for view in held_out]
    before, after = (view_errors(state, traced, judged, context.seed) for state in (without, tried))
    gain, noise = compare(before, after)
    kept = bool(gain > SIGNIFICANCE * noise)
    if kept:
        whole = solver.settle(scene, traced, range(len(capture.views)), lambda share: report(0.85 + 0.15 * share))
        assert whole is not None  # it could for fewer views
        scene = whole
    return scene, {
        "renderer": settings.polish_renderer,
        "held_out_views": len(held_out),
        "before_db": round(float(np.mean(decibels(before))), 3),
        "after_db": round(float(np.mean(decibels(after))), 3),
        "gain_db": round(gain, 3),
        "noise_db": round(noise, 3),
        "kept": kept,
    }


def view_errors(
    scene: Scene, prepared: PreparedReflectance, views: Sequence[ObjectPixels], seed: int
) -> NDArray[np.float64]:
    """Mean squared sRGB error of each view, over pixels drawn from `seed`; a clipped pixel may be brighter."""
    assert scene.material is not None and scene.environment is not None
    chosen = [_judged_pixels(pixels, (seed, number)) for number, pixels in enumerate(views)]
    index, color, saturated = (torch.cat([part[k] for part in chosen]) for k in range(3))
    with torch.no_grad():
        torch.manual_seed(seed)
        passes = [prepared.radiance(scene.material, scene.environment, index) for _ in range(PASSES)]
    difference = linear_to_srgb(torch.stack(passes).mean(dim=0).clamp(0, 1)) - linear_to_srgb(color.clamp(0, 1))
    difference = torch.where(saturated & (difference > 0), torch.zeros_like(difference), difference)
    squares = difference.double().square().mean(dim=1)
    return np.array([float(part.mean()) for part in squares.split([len(part[0]) for part in chosen])])


def _judged_pixels(pixels: ObjectPixels, seed: tuple[int, int]) -> tuple[Tensor, Tensor, Tensor]:
    """Index (N, 3), colour (N, 3) and saturation (N, 1) of at most `JUDGED_PIXELS`, drawn from `seed`."""
    drawn = np.random.default_rng(seed).permutation(len(pixels.index))[:JUDGED_PIXELS]
    rows = torch.from_numpy(np.sort(drawn)).to(pixels.index.device)
    return pixels.index[rows], pixels.color[rows], pixels.saturated[rows]
