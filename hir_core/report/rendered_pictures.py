"""The pictures of a report: photographs beside their fit, the light, the textures."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from hir_exporters.conventions import linear_to_srgb
from hir_exporters.files.atomic import atomic_directory
from hir_exporters.scene_format import load_scene
from hir_exporters.textures.image_files import write_png

from hir_core.capture import block_mean
from hir_core.files.file_names import file_stem
from hir_core.metrics import OBJECT_COVERAGE, Image, composite, mean, psnr, psnr_without_noise, unassociate
from hir_core.rendering.converged_pair import SAMPLES, converged_pair
from hir_core.rendering.map_error_pictures import map_error_pictures
from hir_core.rendering.photographs import MaskedPhotograph, difference_picture, masked_photograph
from hir_core.rendering.reference_renderer import reference_renderer
from hir_core.rendering.unlit_renderer import UnlitRenderer
from hir_core.rendering.view_selection import evenly_spaced_indices
from hir_core.report.relit_pictures import relit_pictures
from hir_core.run.finished_run import FinishedRun, open_finished_run
from hir_core.run.run_directory import RunDirectory
from hir_core.scene.map_error_store import load_map_errors

if TYPE_CHECKING:
    from hir_core.capture import Camera, View
    from hir_core.plugins.manager import PluginManager
    from hir_core.scene import Mesh

VIEWS = 4
"""Number of photographs in a report, evenly spaced over the capture."""

ERROR_SIDE = 512
"""Longest side of a picture of the errors of maps, at most; two stand side by side."""

SMALL_SIDE = 192
"""Approximate maximum side of the renders of intermediate stages, which are measured and not shown."""

UNLIT_STAGE = "initializer"
"""The stage whose scene has colours baked from the photographs and no light; it is rendered unlit, as a result of
photogrammetry is. Later stages keep these colours as an initial guess and are measured by their silhouettes."""


def write_pictures(
    directory: RunDirectory,
    plugins: PluginManager,
    on_message: Callable[[str], None] | None = None,
    *,
    reduced_side: int | None = None,
) -> dict[str, Any]:
    """Replaces the PNG files of `report/` and returns their description for views.json.

    `views`: name, figures and file names of each view, and `measured_at` where the photograph was reduced. `stages`:
    mean PSNR of the same views after each stage, at `SMALL_SIDE`. Both are empty for a run without a reflectance stage.
    `side`: `reduced_side`, which is the run's setting `report_side` unless it is given.
    """
    run = open_finished_run(directory)
    reduced_side = reduced_side or run.report_side
    if run.scene.material is None or run.scene.environment is None:
        if on_message is not None:
            on_message("report: no photograph is compared because the run has fitted no material and no light")
        with atomic_directory(directory.report) as folder:
            _write_asset_pictures(folder, directory.scene)
        return {"views": [], "stages": {}, "side": reduced_side}
    capture = run.views_of_split(run.capture_path, "train", plugins)
    tracer = _PathTracer(run, plugins)
    views: list[dict[str, Any]] = []
    measured: list[tuple[MaskedPhotograph, Camera, Image]] = []
    with atomic_directory(directory.report) as folder:
        for i in evenly_spaced_indices(len(capture.views), VIEWS):
            view = capture.views[i]
            if view.pixels().mask is None:
                if on_message is not None:
                    on_message(f"report: {view.name} is left out because it has no mask")
                continue
            factor = max(1, max(capture.cameras[i].width, capture.cameras[i].height) // reduced_side)
            camera, truth = capture.cameras[i].downsampled(factor), masked_photograph(view).downsampled(factor)
            pair = tracer.pair(camera, view)
            measured.append((truth, camera, _middle(pair)))
            size = {"measured_at": [camera.width, camera.height]} if factor > 1 else {}
            views.append({"name": view.name} | _view_pictures(folder, file_stem(view.name), pair, truth) | size)
        if measured:
            truth, camera, fit = measured[0]
            for name, picture in relit_pictures(run, camera, truth, fit, plugins).items():
                write_png(folder / f"{name}.png", picture)
        _write_asset_pictures(folder, directory.scene)
        lights = list(run.scene.take_radiance.values())
        for number, radiance in enumerate(lights if len(lights) > 1 else []):
            write_png(folder / f"light_take_{number}.png", np.clip(light_picture(radiance.cpu().numpy()), 0, 1))
        errors = load_map_errors(directory.stage("reflectance"))
        if errors is not None and measured:
            cameras = [_small(camera) for _, camera, _ in measured[::2]]
            for name, picture in map_error_pictures(errors, _mesh_of_blocks(directory), cameras).items():
                write_png(folder / f"{name}.png", picture)
    return {"views": views, "stages": stage_psnr(directory, measured), "side": reduced_side}


def _small(camera: Camera) -> Camera:
    return camera.downsampled(max(1, -(-max(camera.width, camera.height) // ERROR_SIDE)))


def _mesh_of_blocks(directory: RunDirectory) -> Mesh:
    """The mesh whose texture coordinates the blocks of `MapErrors` have, in the working frame."""
    from hir_core.scene.scene_store import load_stage_scene

    return load_stage_scene(directory.stage("reflectance") / "scene", "cpu").mesh


def _write_asset_pictures(folder: Path, scene: Path) -> None:
    for name, picture in asset_pictures(scene).items():
        write_png(folder / f"{name}.png", picture)


class _PathTracer:
    """Renders the scene of a run."""

    def __init__(self, run: FinishedRun, plugins: PluginManager) -> None:
        self._in_take = cache(run.scene.in_take)
        _, self._renderer = reference_renderer(
            plugins, bounces=run.bounces, max_samples=SAMPLES, light=run.scene.environment
        )

    def pair(self, camera: Camera, view: View) -> tuple[Image, Image]:
        """Two renders (H, W, 4) with independent noise. A picture is their mean. The figures are means of the product
        of their errors, in which the noise cancels.
        """
        pair = converged_pair(self._renderer, self._in_take(view.take), camera, view.name)
        for fit in pair:
            fit[..., :3] *= view.gain
        return pair


def stage_psnr(
    directory: RunDirectory, measured: list[tuple[MaskedPhotograph, Camera, Image]]
) -> dict[str, float | None]:
    """Mean PSNR over object pixels after the first stage and of the finished asset, at `SMALL_SIDE`.

    `measured`: photographs, their cameras in the working frame, and renders (H, W, 4) of the finished asset.
    """
    from hir_core.scene.scene_store import load_stage_scene

    factors = [max(1, -(-max(camera.width, camera.height) // SMALL_SIDE)) for _, camera, _ in measured]
    truths = [truth.downsampled(factor) for (truth, *_), factor in zip(measured, factors, strict=True)]
    found: dict[str, float | None] = {}
    record = directory.record(UNLIT_STAGE)
    if record is not None and record.finished:
        scene = load_stage_scene(directory.stage(UNLIT_STAGE) / "scene", "cpu")
        if scene.mesh.vertex_colors is not None:
            unlit = UnlitRenderer(scene)
            small = [unlit.render(camera.downsampled(f)) for (_, camera, _), f in zip(measured, factors, strict=True)]
            found[UNLIT_STAGE] = mean([_object_psnr(fit, truth) for fit, truth in zip(small, truths, strict=True)])
    small = [block_mean(fit, factor) for (*_, fit), factor in zip(measured, factors, strict=True)]
    found["reflectance"] = mean([_object_psnr(fit, truth) for fit, truth in zip(small, truths, strict=True)])
    return found


def _object_psnr(fit: Image, truth: MaskedPhotograph) -> float | None:
    return psnr(composite(*unassociate(fit)), truth.picture, truth.mask > OBJECT_COVERAGE)


def asset_pictures(scene: Path) -> dict[str, Image]:
    """Light and textures of a scene folder as sRGB pictures; a constant as a small square."""
    asset = load_scene(scene)
    pictures: dict[str, Image] = {}
    if asset.environment is not None:
        pictures["light"] = light_picture(asset.environment.radiance)
    material = asset.material
    pictures["albedo"] = np.asarray(linear_to_srgb(as_map(material.diffuse_albedo, 3)), dtype=np.float32)
    specular = as_map(material.specular_albedo, 3)
    # a reflectance of a few hundredths would look black, so the largest value is scaled to white
    pictures["specular"] = np.asarray(linear_to_srgb(specular / max(float(specular.max()), 1e-6)), dtype=np.float32)
    pictures["roughness"] = as_map(np.sqrt(material.roughness), 1)
    if material.metalness is not None:
        pictures["metalness"] = as_map(material.metalness, 1)
    if material.normal is not None:
        pictures["normal"] = (material.normal * 0.5 + 0.5).astype(np.float32)
    return {name: np.clip(picture, 0, 1) for name, picture in pictures.items()}


def as_map(value: Image, channels: int) -> Image:
    """(H, W, C) of a texture or a constant."""
    array = np.asarray(value, dtype=np.float32)
    if array.ndim >= 2:
        return array.reshape(*array.shape[:2], channels)
    return np.broadcast_to(array.reshape(-1), (32, 32, channels)).copy()


def light_picture(radiance: Image) -> Image:
    """A lat-long light as a picture; the exposure maps the 95th percentile to 0.8, so the sun is clipped."""
    level = float(np.quantile(radiance.mean(axis=2), 0.95))
    picture = np.asarray(linear_to_srgb(np.clip(radiance * (0.8 / max(level, 1e-6)), 0, 1)), dtype=np.float32)
    enlarge = max(1, 512 // picture.shape[1])
    return picture.repeat(enlarge, axis=0).repeat(enlarge, axis=1)


def _middle(pair: tuple[Image, Image]) -> Image:
    return np.mean(pair, axis=0, dtype=np.float32)


def _view_pictures(folder: Path, name: str, pair: tuple[Image, Image], truth: MaskedPhotograph) -> dict[str, Any]:
    first, second = (composite(*unassociate(fit)) for fit in pair)
    picture, true = composite(*unassociate(_middle(pair))), truth.picture
    files = {kind: f"{name}_{kind}.png" for kind in ("true", "fit", "difference")}
    write_png(folder / files["true"], true)
    write_png(folder / files["fit"], picture)
    write_png(folder / files["difference"], difference_picture(picture, true))
    on_object = truth.mask > OBJECT_COVERAGE
    return files | {
        "frame": psnr_without_noise(first, second, true),
        "object": psnr_without_noise(first, second, true, on_object),
    }
