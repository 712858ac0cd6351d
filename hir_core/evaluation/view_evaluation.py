"""A run against photographs it never saw, under its own light or another (DESIGN section 9)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from hir_exporters.textures.image_files import read_exr, write_exr, write_png
from numpy.typing import NDArray

from hir_core.capture import Capture, Pixels, View
from hir_core.capture.capture_store import restore_capture
from hir_core.errors import CaptureError
from hir_core.evaluation.evaluation_request import Question
from hir_core.evaluation.relighting import lit_scene
from hir_core.files.file_names import file_stem
from hir_core.files.json_documents import write_json
from hir_core.intake.reader_lookup import find_reader
from hir_core.metrics import (
    OBJECT_COVERAGE,
    ChannelScale,
    Image,
    compare,
    composite,
    mask_iou,
    mean,
    psnr,
    unassociate,
)
from hir_core.metrics.perceptual_metrics import Flip, Lpips, find_flip, find_lpips
from hir_core.metrics.published_conventions import stanford_orb
from hir_core.rendering.reference_renderer import (
    OpenRun,
    open_for_rendering,
    reference_renderer,
    render_view,
)
from hir_core.run.run_directory import RunDirectory, claimed_run

if TYPE_CHECKING:
    from hir_core.plugins.manager import PluginManager

Told = Callable[[int, int, str], None]


@dataclass(frozen=True)
class Perceptions:
    """The perceptual metrics that are installed, and why others are not."""

    lpips: Lpips | None
    lpips_vgg: Lpips | None
    flip: Flip | None
    missing: tuple[str, ...]

    @classmethod
    def find(cls, download: bool) -> Perceptions:
        """Those that can be had; weights are fetched only with `download`."""
        (alex, why_alex), (vgg, why_vgg), (flip, why_flip) = (
            find_lpips(download, "alex"),
            find_lpips(download, "vgg"),
            find_flip(),
        )
        return cls(alex, vgg, flip, tuple(dict.fromkeys(why for why in (why_alex, why_vgg, why_flip) if why)))


def evaluate_run(
    directory: RunDirectory, question: Question, plugins: PluginManager, told: Told | None = None
) -> dict[str, Any]:
    """Figures of one run on one split; also written to `evaluation/<split>/` with a picture of each view."""
    from hir_core.evaluation.truth_evaluation import against_truth

    run = open_for_rendering(directory, question.device)
    path = question.capture or run.capture_path
    capture = split_in_working_frame(run, path, question.split, plugins)
    if question.views:
        chosen = spread(len(capture.views), question.views)
        capture = replace(capture, views=tuple(capture.views[i] for i in chosen))
    scene, light = lit_scene(run, path, capture, question.relight, plugins, question.device)
    renderer_name, renderer = reference_renderer(plugins, question.renderer, question.options, run.bounces)
    perceptions = Perceptions.find(question.download)
    folder = directory.evaluation(_label(question))
    relit = not light["fitted"]

    scale = ChannelScale()
    names = [file_stem(view.name) for view in capture.views]
    if len(set(names)) < len(names):
        names = [f"{i:04d}_{name}" for i, name in enumerate(names)]
    views: list[dict[str, Any]] = []
    for i, (view, name) in enumerate(zip(capture.views, names, strict=True)):
        started = time.perf_counter()
        camera = capture.cameras[i]
        fit = render_view(renderer, scene, camera, view.name)
        fit[..., :3] *= view.exposure
        seconds = time.perf_counter() - started
        truth = masked_pixels(view)
        inside = (truth.mask > OBJECT_COVERAGE) & ~truth.saturated
        scale.add(unassociate(fit)[0][inside], truth.color_linear[inside])
        write_exr(folder / f"{name}.exr", fit)
        figures = _figures(fit, truth, perceptions, relit)
        views.append({"name": view.name, "file": f"{name}.exr", "seconds": round(seconds, 3)} | figures)
        _write_pictures(folder, name, fit, truth)
        if told is not None:
            told(i + 1, len(names), f"{views[-1]['psnr']['object']:.2f} dB")
    for entry, view, name in zip(views, capture.views, names, strict=True):
        entry["psnr_scaled"] = _scaled(read_exr(folder / f"{name}.exr"), masked_pixels(view), scale.value)

    result = {
        "run": str(directory.path),
        "capture": str(path),
        "split": question.split,
        "light": light,
        "renderer": renderer_name,
        **_means(views),
        "scale": scale.value.tolist(),
        "lpips_missing": " ".join(perceptions.missing) or None,
        "seconds_per_view": round(float(np.mean([view["seconds"] for view in views])), 3),
        **against_truth(run, path, capture, question, plugins),
        "views": views,
    }
    write_json(folder / "metrics.json", result)
    if path.resolve() == run.capture_path.resolve():
        _record(directory, _label(question), result)
    return result


def split_in_working_frame(run: OpenRun, path: Path, split: str, plugins: PluginManager) -> Capture:
    """A split of a capture, in the working frame; the train split has the cameras and masks that the run found."""
    if split != "train" or path.resolve() != run.capture_path.resolve():
        capture = run.read(path, split, plugins)
    else:
        _, reader = find_reader(path, plugins, run.document["capture"].get("reader", "auto"))
        capture = restore_capture(reader.read(path, split), run.directory.stage("initializer"))
    if not capture.views:
        raise CaptureError(f"{path}: split {split!r} has no views")
    return capture


def spread(count: int, wanted: int) -> list[int]:
    """At most `wanted` numbers of range(count), evenly apart from first to last."""
    shown = min(count, wanted)
    return sorted({round(i * (count - 1) / max(shown - 1, 1)) for i in range(shown)})


@dataclass(frozen=True)
class Truth:
    """A photograph whose object is known."""

    color_linear: Image
    mask: Image
    saturated: NDArray[np.bool_]

    @property
    def picture(self) -> Image:
        """Composited over black (`hir_core.metrics`)."""
        return composite(self.color_linear, self.mask)

    def downsampled(self, factor: int) -> Truth:
        """At 1/`factor` of the resolution, as `Pixels` does it."""
        small = Pixels(self.color_linear, self.mask, self.saturated).downsampled(factor)
        assert small.mask is not None
        return Truth(small.color_linear, small.mask, small.saturated)


def masked_pixels(view: View) -> Truth:
    """The photograph with its mask; an error where it has none, for then the background would count as the object."""
    pixels = view.pixels()
    if pixels.mask is None:
        raise CaptureError(f"view {view.name} has no mask, so its background cannot be told from the object; add alpha")
    return Truth(pixels.color_linear, pixels.mask, pixels.saturated)


def _figures(fit: Image, truth: Truth, perceptions: Perceptions, relit: bool) -> dict[str, Any]:
    color, coverage = unassociate(fit)
    figures = compare(composite(color, coverage), truth.picture, truth.mask, perceptions.lpips, perceptions.flip)
    # Stanford-ORB has no coverage of the fit: its pictures are the light that reaches the camera, black behind
    orb = stanford_orb(fit[..., :3], truth.color_linear, truth.mask, relit, perceptions.lpips_vgg)
    return figures.document() | {"iou": mask_iou(coverage, truth.mask), "stanford_orb": orb.document()}


def _scaled(fit: Image, truth: Truth, scale: np.ndarray) -> dict[str, Any]:
    color, coverage = unassociate(fit)
    picture = composite((color * scale).astype(np.float32), coverage)
    true = truth.picture
    return {"frame": psnr(picture, true), "object": psnr(picture, true, truth.mask > OBJECT_COVERAGE)}


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


def _write_pictures(folder: Path, name: str, fit: Image, truth: Truth) -> None:
    color, coverage = unassociate(fit)
    picture, true = composite(color, coverage), truth.picture
    write_png(folder / f"{name}_fit.png", picture)
    write_png(folder / f"{name}_true.png", true)
    write_png(folder / f"{name}_difference.png", difference_picture(picture, true))


def difference_picture(fit: Image, truth: Image) -> Image:
    """Where they differ, five times enlarged: grey is equal, brighter where the fit is brighter."""
    return np.asarray(np.clip(0.5 + 2.5 * (fit - truth), 0.0, 1.0), dtype=np.float32)


def _label(question: Question) -> str:
    if not question.relight:
        return question.split
    return f"{question.split}-{file_stem(Path(question.relight.rpartition('*')[0] or question.relight).stem)}"


def _record(directory: RunDirectory, label: str, result: dict[str, Any]) -> None:
    """Adds the means to run.json."""
    kept = (
        "psnr",
        "psnr_scaled",
        "scale",
        "ssim",
        "lpips",
        "flip",
        "iou",
        "stanford_orb",
        "light",
        "renderer",
        "surface",
        "albedo",
        "light_error",
    )
    with claimed_run(directory.path, resume=True):
        document = directory.read_run()
        document["metrics"] = dict(document.get("metrics", {})) | {
            label: {key: result[key] for key in kept if key in result}
        }
        directory.write_run(document)
