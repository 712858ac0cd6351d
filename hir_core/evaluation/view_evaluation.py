"""Errors of a run in views that the fit did not use, under the fitted light or another one (docs/evaluation.md)."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from hir_exporters.textures.image_files import read_exr, write_exr, write_png
from numpy.typing import NDArray

from hir_core.evaluation.evaluation_request import EvaluationRequest
from hir_core.evaluation.relighting import lit_scene
from hir_core.files.file_names import file_stem
from hir_core.files.json_documents import write_json
from hir_core.metrics import (
    OBJECT_COVERAGE,
    ChannelScale,
    Image,
    compare,
    composite,
    mask_iou,
    mean,
    nearest_exposure,
    psnr,
    unassociate,
)
from hir_core.metrics.perceptual_metrics import Flip, Lpips, find_flip, find_lpips
from hir_core.metrics.published_conventions import stanford_orb
from hir_core.rendering.photographs import MaskedPhotograph, difference_picture, masked_photograph
from hir_core.rendering.reference_renderer import reference_renderer, render_view
from hir_core.rendering.view_selection import evenly_spaced_indices
from hir_core.run.finished_run import open_finished_run
from hir_core.run.run_directory import RunDirectory, claimed_run

if TYPE_CHECKING:
    from hir_core.capture import View
    from hir_core.plugins.manager import PluginManager

OnView = Callable[[int, int, str], None]
"""Called after each view with its number from 1, the number of views, and its PSNR as text."""

RECORDED_KEYS = (
    "psnr",
    "psnr_scaled",
    "scale",
    "ssim",
    "lpips",
    "flip",
    "iou",
    "stanford_orb",
    "light",
    "exposures",
    "renderer",
    "surface",
    "albedo",
    "light_error",
    "scan_texture",
)
"""Entries of the result that run.json repeats."""


@dataclass(frozen=True)
class PerceptualMetrics:
    """The perceptual metrics that are installed, and one sentence for each that is not."""

    lpips: Lpips | None
    lpips_vgg: Lpips | None
    flip: Flip | None
    missing: tuple[str, ...]

    @classmethod
    def load(cls, download: bool) -> PerceptualMetrics:
        """Loads the installed ones; missing weights are downloaded only with `download`."""
        (alex, why_alex), (vgg, why_vgg), (flip, why_flip) = (
            find_lpips(download, "alex"),
            find_lpips(download, "vgg"),
            find_flip(),
        )
        return cls(alex, vgg, flip, tuple(dict.fromkeys(why for why in (why_alex, why_vgg, why_flip) if why)))


def evaluate_run(
    directory: RunDirectory, request: EvaluationRequest, plugins: PluginManager, on_view: OnView | None = None
) -> dict[str, Any]:
    """Errors of one run on one split.

    Writes `evaluation/<label>/` with metrics.json and a picture of each view, and the means into run.json where the
    capture is the run's own.
    """
    from hir_core.evaluation.scan_texture_figures import scan_texture_figures
    from hir_core.evaluation.truth_evaluation import check_truth, compare_with_truth

    run = open_finished_run(directory, request.device)
    path = request.capture or run.capture_path
    capture = run.views_of_split(path, request.split, plugins)
    check_truth(run, path, request, plugins)
    if request.views:
        chosen = evenly_spaced_indices(len(capture.views), request.views)
        capture = replace(capture, views=tuple(capture.views[i] for i in chosen))
    scene, light = lit_scene(run, path, capture, request.relight, plugins, request.device)
    renderer_name, renderer = reference_renderer(
        plugins, request.renderer, request.options, run.bounces, light=scene.environment
    )
    metrics = PerceptualMetrics.load(request.download)
    folder = directory.evaluation(request.label)
    is_relit = not light["fitted"]
    at_own = run.exposures.kind == "fitted" and capture.split != "train" and not is_relit

    in_take = cache(scene.in_take)  # a renderer prepares a scene once
    scale = ChannelScale()
    names = _file_names(capture.views)
    views: list[dict[str, Any]] = []
    for i, (view, name) in enumerate(zip(capture.views, names, strict=True)):
        started = time.perf_counter()
        fit = render_view(renderer, in_take(view.take), capture.cameras[i], view.name)
        seconds = time.perf_counter() - started
        photograph = masked_photograph(view)
        inside = (photograph.mask > OBJECT_COVERAGE) & ~photograph.saturated
        factors = _own_exposure(fit, photograph, inside) if at_own else view.gain
        fit[..., :3] *= factors
        scale.add(unassociate(fit)[0][inside], photograph.color_linear[inside])
        write_exr(folder / f"{name}.exr", fit)
        figures = _figures(fit, photograph, metrics, is_relit)
        shown = {"exposure": [round(float(factor), 4) for factor in factors]} if run.exposures.kind != "equal" else {}
        views.append({"name": view.name, "file": f"{name}.exr", "seconds": round(seconds, 3)} | shown | figures)
        _write_pictures(folder, name, fit, photograph)
        if on_view is not None:
            on_view(i + 1, len(names), f"{views[-1]['psnr']['object']:.2f} dB")
    for entry, view, name in zip(views, capture.views, names, strict=True):
        # the scale is known only now; photographs are decoded twice so that memory does not grow with their number
        entry["psnr_scaled"] = _scaled_psnr(read_exr(folder / f"{name}.exr"), masked_photograph(view), scale.value)

    texture_light = scene.environment if is_relit else None
    own_exposure = _own_exposure if at_own else None
    result = {
        "run": str(directory.path),
        "capture": str(path),
        "split": request.split,
        "light": light,
        "renderer": renderer_name,
        "exposures": "fitted to each view" if at_own else None,
        **_means(views),
        "scale": scale.value.tolist(),
        "lpips_missing": " ".join(metrics.missing) or None,
        "seconds_per_view": round(float(np.mean([view["seconds"] for view in views])), 3),
        **compare_with_truth(run, path, capture, request, plugins),
        **scan_texture_figures(run, capture, names, folder, texture_light, renderer, own_exposure),
        "views": views,
    }
    write_json(folder / "metrics.json", result)
    if path.resolve() == run.capture_path.resolve():
        _record(directory, request.label, result)
    return result


def _own_exposure(fit: Image, photograph: MaskedPhotograph, inside: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Brightness and white balance that bring a render nearest to its photograph, where exposures were fitted."""
    return nearest_exposure(unassociate(fit)[0][inside], photograph.color_linear[inside])


def _file_names(views: Sequence[View]) -> list[str]:
    """A file name without suffix for each view, all different."""
    names = [file_stem(view.name) for view in views]
    if len(set(names)) < len(names):
        return [f"{i:04d}_{name}" for i, name in enumerate(names)]
    return names


def _figures(fit: Image, photograph: MaskedPhotograph, metrics: PerceptualMetrics, is_relit: bool) -> dict[str, Any]:
    color, coverage = unassociate(fit)
    figures = compare(composite(color, coverage), photograph.picture, photograph.mask, metrics.lpips, metrics.flip)
    # Stanford-ORB ignores the coverage of the fit: its pictures are the radiance over a black background
    orb = stanford_orb(fit[..., :3], photograph.color_linear, photograph.mask, is_relit, metrics.lpips_vgg)
    return figures.document() | {"iou": mask_iou(coverage, photograph.mask), "stanford_orb": orb.document()}


def _scaled_psnr(fit: Image, photograph: MaskedPhotograph, scale: NDArray[np.float64]) -> dict[str, Any]:
    color, coverage = unassociate(fit)
    picture = composite((color * scale).astype(np.float32), coverage)
    true = photograph.picture
    return {"frame": psnr(picture, true), "object": psnr(picture, true, photograph.mask > OBJECT_COVERAGE)}


def _means(views: list[dict[str, Any]]) -> dict[str, Any]:
    def both(key: str) -> dict[str, Any]:
        return {part: mean([view[key][part] for view in views]) for part in ("frame", "object")}

    return {
        "psnr": both("psnr"),
        "psnr_scaled": both("psnr_scaled"),
        **{key: mean([view[key] for view in views]) for key in ("ssim", "lpips", "flip", "iou")},
        "stanford_orb": {
            key: mean([view["stanford_orb"][key] for view in views]) for key in ("psnr_h", "psnr_l", "ssim", "lpips")
        },
    }


def _write_pictures(folder: Path, name: str, fit: Image, photograph: MaskedPhotograph) -> None:
    color, coverage = unassociate(fit)
    picture, true = composite(color, coverage), photograph.picture
    write_png(folder / f"{name}_fit.png", picture)
    write_png(folder / f"{name}_true.png", true)
    write_png(folder / f"{name}_difference.png", difference_picture(picture, true))


def _record(directory: RunDirectory, label: str, result: dict[str, Any]) -> None:
    """Adds the means to run.json."""
    with claimed_run(directory.path, resume=True):
        document = directory.read_run()
        means = {key: result[key] for key in RECORDED_KEYS if key in result}
        document["metrics"] = dict(document.get("metrics", {})) | {label: means}
        directory.write_run(document)
