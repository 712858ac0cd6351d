"""A run against what is known of its object beyond photographs: the true mesh, albedo and light. For judging only."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np
from hir_exporters.conventions import linear_to_srgb
from hir_exporters.light.environment_map import resample_latlong, rotate_latlong
from numpy.typing import NDArray

from hir_core.capture import Capture
from hir_core.errors import InputError
from hir_core.intake.reader_lookup import find_reader
from hir_core.metrics import OBJECT_COVERAGE, ChannelScale, mean, psnr, unassociate
from hir_core.metrics.light_metrics import ROWS, compare_lights
from hir_core.metrics.published_conventions import stanford_orb_albedo
from hir_core.metrics.surface_metrics import compare_surfaces
from hir_core.rendering.reference_renderer import OpenRun, light_of
from hir_core.rendering.unlit import UnlitView

if TYPE_CHECKING:
    from hir_core.evaluation.evaluation_request import Question
    from hir_core.plugins.manager import PluginManager
    from hir_core.scene import EnvironmentMap

TRUE_MESH: Final = "reference.obj"
"""The file of a capture that holds its true mesh."""


def against_truth(
    run: OpenRun, path: Path, capture: Capture, question: Question, plugins: PluginManager
) -> dict[str, Any]:
    """Entries `surface`, `albedo`, `light_error` of the result: those that are asked for, or that `truth` finds."""
    found: dict[str, Any] = {}
    mesh = question.mesh
    if mesh is None and question.truth and (path / TRUE_MESH).is_file():
        mesh = path / TRUE_MESH
    if mesh is not None:
        found["surface"] = surface_figures(run, mesh, capture)
    albedo = question.albedo
    if not albedo and question.truth:
        _, reader = find_reader(path, plugins)
        albedo = f"albedo_{question.split}" if f"albedo_{question.split}" in reader.splits(path) else ""
    if albedo:
        found["albedo"] = albedo_figures(run, path, albedo, plugins)
    if question.truth and capture.environment is not None and not question.relight:
        light = light_figures(run, path, capture, plugins)
        if light is not None:
            found["light_error"] = light
    return found


def surface_figures(run: OpenRun, mesh: Path, capture: Capture) -> dict[str, Any]:
    """The run's mesh against a file's, which stands in the axes of the capture's own files.

    `seen` counts only points of the truth that some view of the split sees.
    """
    positions, faces = true_mesh(mesh, run)
    fit = (run.scene.mesh.positions.detach().cpu().numpy(), run.scene.mesh.faces.cpu().numpy())
    whole = compare_surfaces(fit, (positions, faces))
    seen = compare_surfaces(fit, (positions, faces), capture.cameras)
    return {"file": mesh.name, **whole.document(), "seen": seen.document()}


def true_mesh(path: Path, run: OpenRun) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Positions (V, 3) in the run's working frame and faces (F, 3) of a mesh file in the capture's own axes."""
    import trimesh

    if not path.is_file():
        raise InputError(f"--mesh {path}: there is no such file")
    try:
        found = cast(Any, trimesh.load(path, process=False, force="mesh"))
        positions, faces = np.asarray(found.vertices, np.float64), np.asarray(found.faces, np.int64)
    except Exception as error:  # trimesh raises whatever its parsers do
        raise InputError(f"{path} cannot be read as a mesh ({type(error).__name__}: {error})") from error
    if not len(faces) or not np.isfinite(positions).all():
        raise InputError(f"{path} has no triangles to compare with, or corners that are not numbers")
    moved = run.working_from_asset @ run.asset_from_source
    return positions @ moved[:3, :3].T + moved[:3, 3], faces


def albedo_figures(run: OpenRun, path: Path, split: str, plugins: PluginManager) -> dict[str, Any]:
    """The diffuse albedo, seen without light from the views of a split of true albedo, over its object's pixels.

    PSNR of its sRGB, as it is and after one linear factor a channel for the whole split (the scale between albedo and
    light cannot be observed), and by Stanford-ORB's rules.
    """
    capture = run.read(path, split, plugins)
    unlit = UnlitView(run.scene)
    scale = ChannelScale()
    pairs, orb = [], []
    for view, camera in zip(capture.views, capture.cameras, strict=True):
        pixels = view.pixels()
        coverage = np.ones(pixels.color_linear.shape[:2], np.float32) if pixels.mask is None else pixels.mask
        color, own = unassociate(unlit.render(camera))
        # where the fit has no surface there is no albedo to judge: the outline is the surface figures' to tell
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


def light_figures(run: OpenRun, path: Path, capture: Capture, plugins: PluginManager) -> dict[str, Any] | None:
    """The fitted light against that of train; None where either is not known, or the fit's moves with the camera."""
    _, reader = find_reader(path, plugins)
    source = reader.read(path, "train").environment if "train" in reader.splits(path) else None
    fitted = run.scene.environment
    if source is None or fitted is None or fitted.frame == "camera":
        return None
    truth = light_of(source, capture.world_from_source)
    return compare_lights(in_world(fitted), in_world(truth)).document()


def in_world(light: EnvironmentMap) -> NDArray[np.float64]:
    """A light's radiance (H, W, 3) in the axes of the world, at least `ROWS` high."""
    radiance = light.radiance.detach().cpu().numpy().astype(np.float64)
    rows = max(ROWS, min(radiance.shape[0], 4 * ROWS))
    radiance = resample_latlong(radiance, rows, 2 * rows)
    return radiance if light.to_world is None else rotate_latlong(radiance, light.to_world.detach().cpu().numpy())


def _srgb(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(linear_to_srgb(np.clip(linear, 0, 1)), dtype=np.float32)
