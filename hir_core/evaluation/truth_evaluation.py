"""Errors of a run against the ground truth of a capture: mesh, albedo, light. No fit reads these."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from hir_exporters.conventions import linear_to_srgb
from hir_exporters.light.environment_map import resample_latlong, rotate_latlong
from hir_exporters.reading.mesh_references import load_mesh_scene
from numpy.typing import NDArray

from hir_core.capture import Capture
from hir_core.errors import HirError, InputError
from hir_core.evaluation.relighting import training_light
from hir_core.intake.reader_lookup import find_reader
from hir_core.metrics import OBJECT_COVERAGE, ChannelScale, mean, psnr, unassociate
from hir_core.metrics.light_metrics import ROWS, compare_lights
from hir_core.metrics.published_conventions import stanford_orb_albedo
from hir_core.metrics.surface_metrics import compare_surfaces
from hir_core.rendering.light_files import load_light
from hir_core.rendering.unlit_renderer import UnlitRenderer
from hir_core.run.finished_run import FinishedRun

if TYPE_CHECKING:
    from hir_core.evaluation.evaluation_request import EvaluationRequest
    from hir_core.plugins.manager import PluginManager
    from hir_core.scene import EnvironmentMap

TRUE_MESH: Final = "reference.obj"
"""File name of the true mesh in a capture."""


def compare_with_truth(
    run: FinishedRun, path: Path, capture: Capture, request: EvaluationRequest, plugins: PluginManager
) -> dict[str, Any]:
    """Entries `surface`, `albedo`, `light_error` of the result: those requested, or with `truth` all available."""
    result: dict[str, Any] = {}
    mesh = requested_mesh(request, path)
    if mesh is not None:
        result["surface"] = surface_figures(run, mesh, capture)
    albedo = request.albedo
    if not albedo and request.truth:
        _, reader = find_reader(path, plugins)
        albedo = f"albedo_{request.split}" if f"albedo_{request.split}" in reader.splits(path) else ""
    if albedo:
        result["albedo"] = albedo_figures(run, path, albedo, plugins)
    if request.truth and capture.environment is not None and not request.relight:
        light = light_figures(run, path, capture, plugins)
        if light is not None:
            result["light_error"] = light
    return result


def requested_mesh(request: EvaluationRequest, path: Path) -> Path | None:
    """The true mesh that a request names, or with `truth` that of the capture at `path`; None without one."""
    if request.mesh is None and request.truth and (path / TRUE_MESH).is_file():
        return path / TRUE_MESH
    return request.mesh


def check_truth(run: FinishedRun, path: Path, request: EvaluationRequest, plugins: PluginManager) -> None:
    """Reads the mesh and opens the split of albedo that a request names; `InputError` where one is wrong.

    It is called before the views are rendered, which takes minutes.
    """
    if (mesh := requested_mesh(request, path)) is not None:
        true_mesh(mesh, run)
    if request.albedo:
        run.read_split(path, request.albedo, plugins)


def surface_figures(run: FinishedRun, mesh: Path, capture: Capture) -> dict[str, Any]:
    """Errors of the run's mesh against a mesh file in the axes of the capture's files.

    The entry `seen` counts only those points of the true mesh that are visible in a view of the split.
    """
    positions, faces = true_mesh(mesh, run)
    fit = (run.scene.mesh.positions.detach().cpu().numpy(), run.scene.mesh.faces.cpu().numpy())
    whole = compare_surfaces(fit, (positions, faces))
    seen = compare_surfaces(fit, (positions, faces), capture.cameras)
    return {"file": mesh.name, **whole.document(), "seen": seen.document()}


def true_mesh(path: Path, run: FinishedRun) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Positions (V, 3) in the working frame and faces (F, 3) of a mesh file in the axes of the capture's files.

    `InputError` where the file is missing or no mesh of finite positions.
    """
    if not path.is_file():
        raise InputError(f"--mesh {path}: no such file")
    try:
        mesh = load_mesh_scene(path, process=False).to_mesh()
        positions, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    except HirError:
        raise
    except Exception as error:  # parsers of trimesh raise many types
        raise InputError(f"{path} cannot be read as a mesh ({type(error).__name__}: {error})") from error
    if not len(faces) or not np.isfinite(positions).all():
        raise InputError(f"{path} has no triangles, or vertices that are not finite")
    moved = run.frames.working_from_source
    return positions @ moved[:3, :3].T + moved[:3, 3], faces


def albedo_figures(run: FinishedRun, path: Path, split: str, plugins: PluginManager) -> dict[str, Any]:
    """PSNR of the diffuse albedo in the views of a split of true albedo, over the object's pixels, in sRGB.

    Unscaled; scaled by one linear factor per channel for the whole split, because the scale between albedo and light
    is not observable; and by the rules of Stanford-ORB.
    """
    capture = run.read_split(path, split, plugins)
    unlit = UnlitRenderer(run.scene)
    scale = ChannelScale()
    pairs, orb = [], []
    for view, camera in zip(capture.views, capture.cameras, strict=True):
        pixels = view.pixels()
        coverage = np.ones(pixels.color_linear.shape[:2], np.float32) if pixels.mask is None else pixels.mask
        color, own = unassociate(unlit.render(camera))
        # pixels without a fitted surface have no albedo; the surface figures measure the outline
        inside = (coverage > OBJECT_COVERAGE) & (own > OBJECT_COVERAGE)
        pairs.append((color[inside], pixels.color_linear[inside]))
        scale.add(*pairs[-1])
        orb.append(stanford_orb_albedo(color * own[..., None], pixels.color_linear, coverage))
    factor = scale.value.astype(np.float32)
    return {
        "split": split,
        "psnr": mean([psnr(_srgb(fit), _srgb(truth)) for fit, truth in pairs]),
        "psnr_scaled": mean([psnr(_srgb(fit * factor), _srgb(truth)) for fit, truth in pairs]),
        "scale": factor.tolist(),
        "stanford_orb_psnr": mean(list(orb)),
    }


def light_figures(run: FinishedRun, path: Path, capture: Capture, plugins: PluginManager) -> dict[str, Any] | None:
    """Errors of the fitted light against that of the train split.

    None where either is unknown, where the fitted light is attached to the camera, and where each take has its own.
    """
    source = training_light(path, plugins)
    fitted = run.scene.environment
    if source is None or fitted is None or fitted.frame == "camera" or run.scene.take_radiance:
        return None
    truth = load_light(source, capture.world_from_source)
    return compare_lights(in_world(fitted), in_world(truth)).document()


def in_world(light: EnvironmentMap) -> NDArray[np.float64]:
    """Radiance (H, W, 3) of a light in world axes, between `ROWS` and 4 `ROWS` rows."""
    radiance = light.radiance.detach().cpu().numpy().astype(np.float64)
    rows = max(ROWS, min(radiance.shape[0], 4 * ROWS))
    radiance = resample_latlong(radiance, rows, 2 * rows)
    return radiance if light.to_world is None else rotate_latlong(radiance, light.to_world.detach().cpu().numpy())


def _srgb(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(linear_to_srgb(np.clip(linear, 0, 1)), dtype=np.float32)
