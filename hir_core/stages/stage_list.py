"""The six stages of a run, each declared once. What they compute lies in the modules that they import when they run."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hir_core.capture import CoordinateFrames
from hir_core.capture.photograph_exposures import EQUAL_EXPOSURES, PhotographExposures
from hir_core.files.file_checksums import file_hash
from hir_core.files.json_documents import read_json, write_json
from hir_core.files.light_setting import parse_light_file
from hir_core.run.capture_store import read_exposures, restore_capture, save_capture, write_cameras
from hir_core.run.stage import SkippedStageReport, Stage, StageResult
from hir_core.run.stage_context import StageContext
from hir_core.stages.run_state import RunState

if TYPE_CHECKING:
    from hir_exporters.asset import Asset

    from hir_core.scene import Scene
    from hir_core.scene.map_errors import MapErrors
    from hir_core.stages.geometry.geometry_fit import FittedGeometry
    from hir_core.stages.initialization import InitializedCapture


@dataclass(frozen=True)
class FittedScene:
    """Value of the reflectance stage."""

    scene: Scene
    exposures: PhotographExposures
    bounces: int | None
    map_errors: MapErrors | None


def _initializer_settings(state: RunState) -> Any:
    from hir_core.stages.initialization import hashes_of_files_read

    config = state.config
    hashes = hashes_of_files_read(state.capture, config, state.plugins)
    depth_maps = asdict(config.depth_maps)
    return [list(config.initializers), config.masks, config.initializer, config.mask_source, depth_maps, hashes]


def _initialize(state: RunState, context: StageContext) -> StageResult[InitializedCapture]:
    from hir_core.stages.initialization import initialize

    return StageResult(*initialize(state.capture, state.config, context))


def _save_initialized(state: RunState, value: InitializedCapture, folder: Path) -> None:
    from hir_core.scene.scan import save_scan
    from hir_core.scene.scene_store import save_stage_scene

    save_capture(value.capture, folder)
    save_stage_scene(value.scene, folder / "scene")
    if value.unchanged_scene is not None:
        save_stage_scene(value.unchanged_scene, folder / UNCHANGED_SCENE)
    write_json(folder / "frames.json", value.frames.as_document())
    save_scan(value.scan, folder)


def _load_initialized(state: RunState, folder: Path) -> InitializedCapture:
    from hir_core.scene.scan import load_scan
    from hir_core.scene.scene_store import load_stage_scene
    from hir_core.stages.initialization import InitializedCapture

    path, unchanged = folder / "frames.json", folder / UNCHANGED_SCENE
    return InitializedCapture(
        restore_capture(state.capture, folder),
        load_stage_scene(folder / "scene", state.device),
        CoordinateFrames.from_document(read_json(path), str(path)),
        load_scan(folder),
        load_stage_scene(unchanged, state.device) if unchanged.exists() else None,
    )


def _extend_initialized(state: RunState, value: InitializedCapture) -> RunState:
    in_asset_frame = value.capture.transformed(value.frames.asset_from_working)
    write_cameras(state.directory.cameras, in_asset_frame, state.source.view_names)
    capture = state.photographs.undistort(value.capture)
    scan_file = "" if value.scan is None else value.scan.file
    return replace(
        state,
        capture=capture,
        scene=value.scene,
        unchanged_scene=value.unchanged_scene,
        frames=value.frames,
        scan_file=scan_file,
    )


def _geometry_settings(state: RunState) -> Any:
    settings = state.config.geometry
    if not settings.enabled:
        return SWITCHED_OFF
    return [asdict(settings), state.config.geometry_renderer.get(settings.renderer, {})]


def _fit_geometry(state: RunState, context: StageContext) -> StageResult[FittedGeometry]:
    from hir_core.stages.geometry.geometry_fit import FittedGeometry, fit_geometry

    if not state.config.geometry.enabled:
        return StageResult(FittedGeometry(_scene(state)), SkippedStageReport())
    return StageResult(*fit_geometry(_scene(state), state.capture, state.config.geometry, context))


def _save_geometry(state: RunState, value: FittedGeometry, folder: Path) -> None:
    from hir_core.files.array_files import write_arrays

    _save_scene(state, value.scene, folder)
    if value.silhouette_positions is not None:
        write_arrays(folder / SILHOUETTES, {"positions": value.silhouette_positions.cpu().numpy()})


def _load_geometry(state: RunState, folder: Path) -> FittedGeometry:
    import torch

    from hir_core.files.array_files import read_arrays
    from hir_core.stages.geometry.geometry_fit import FittedGeometry

    scene, path = _load_scene(state, folder), folder / SILHOUETTES
    if not path.exists():
        return FittedGeometry(scene)
    positions = torch.from_numpy(read_arrays(path)["positions"]).to(scene.mesh.positions)
    return FittedGeometry(scene, positions)


def _unwrap(state: RunState, context: StageContext) -> StageResult[Scene]:
    from hir_core.stages.atlas import unwrap

    mesh_name = state.scan_file or "the mesh"
    return StageResult(*unwrap(_scene(state), state.capture, state.config.atlas, context, mesh_name))


def _reflectance_settings(state: RunState) -> Any:
    settings = state.config.reflectance
    if not settings.enabled:
        return SWITCHED_OFF
    light_hash = file_hash(parse_light_file(settings.known_environment)[0]) if settings.known_environment else ""
    return [asdict(settings), light_hash, state.config.reflectance_renderer]


def _fit_reflectance(state: RunState, context: StageContext) -> StageResult[FittedScene]:
    scene = _scene(state)
    if not state.config.reflectance.enabled:
        return StageResult(FittedScene(scene, EQUAL_EXPOSURES, None, None), SkippedStageReport())
    from hir_core.stages.shape_revision import fit_reflectance_and_revise

    found = fit_reflectance_and_revise(
        scene, state.capture, state.config, context, state.silhouette_positions, state.unchanged_scene
    )
    value = FittedScene(found.scene, found.exposures, found.report.bounces, found.map_errors)
    return StageResult(value, found.report)


def _save_fitted(state: RunState, value: FittedScene, folder: Path) -> None:
    _save_scene(state, value.scene, folder)
    write_json(folder / "model.json", {"bounces": value.bounces, "exposures": value.exposures.as_document()})
    if value.map_errors is not None:
        from hir_core.scene.map_error_store import save_map_errors

        save_map_errors(value.map_errors, folder)


def _load_fitted(state: RunState, folder: Path) -> FittedScene:
    from hir_core.scene.map_error_store import load_map_errors

    path = folder / "model.json"
    bounces = read_json(path).get("bounces")
    exposures = read_exposures(path)
    bounces = bounces if isinstance(bounces, int) else None
    return FittedScene(_load_scene(state, folder), exposures, bounces, load_map_errors(folder))


def _bake(state: RunState, context: StageContext) -> StageResult[Asset]:
    from hir_core.stages.bake import bake_stage

    return StageResult(*bake_stage(state))


def _save_asset(state: RunState, asset: Asset, folder: Path) -> None:
    from hir_exporters.scene_format import save_scene

    save_scene(asset, state.directory.scene)


def _load_asset(state: RunState, folder: Path) -> Asset:
    from hir_exporters.scene_format import load_scene

    return load_scene(state.directory.scene)


def _export(state: RunState, context: StageContext) -> StageResult[None]:
    from hir_core.stages.export.export_stage import export_stage

    return StageResult(None, export_stage(state, context))


def _scene(state: RunState) -> Scene:
    assert state.scene is not None
    return state.scene


def _save_scene(state: RunState, scene: Scene, folder: Path) -> None:
    from hir_core.scene.scene_store import save_stage_scene

    save_stage_scene(scene, folder / "scene")


def _load_scene(state: RunState, folder: Path) -> Scene:
    from hir_core.scene.scene_store import load_stage_scene

    return load_stage_scene(folder / "scene", state.device)


def _extend_scene(state: RunState, scene: Scene) -> RunState:
    return replace(state, scene=scene)


SWITCHED_OFF = "switched off"
"""The cache key of a stage that the settings switch off."""

UNCHANGED_SCENE = "unchanged_scene"
"""Folder of the scene before the first initializer with the trait `revises_mesh`."""

SILHOUETTES = "silhouettes.npz"
"""Vertices of the geometry stage before photo-consistency moved them."""

INITIALIZER: Stage[RunState, InitializedCapture] = Stage(
    name="initializer",
    settings=_initializer_settings,
    compute=_initialize,
    save=_save_initialized,
    load=_load_initialized,
    extend=_extend_initialized,
    scene=_scene,
)
GEOMETRY: Stage[RunState, FittedGeometry] = Stage(
    name="geometry",
    settings=_geometry_settings,
    compute=_fit_geometry,
    save=_save_geometry,
    load=_load_geometry,
    extend=lambda state, value: replace(state, scene=value.scene, silhouette_positions=value.silhouette_positions),
    scene=_scene,
)
ATLAS: Stage[RunState, Scene] = Stage(
    name="atlas",
    settings=lambda state: asdict(state.config.atlas),
    compute=_unwrap,
    save=_save_scene,
    load=_load_scene,
    extend=_extend_scene,
    scene=_scene,
)
REFLECTANCE: Stage[RunState, FittedScene] = Stage(
    name="reflectance",
    settings=_reflectance_settings,
    compute=_fit_reflectance,
    save=_save_fitted,
    load=_load_fitted,
    extend=lambda state, value: replace(state, scene=value.scene, bounces=value.bounces),
    scene=_scene,
)
BAKE: Stage[RunState, Asset] = Stage(
    name="bake",
    settings=lambda state: state.source.name,
    compute=_bake,
    save=_save_asset,
    load=_load_asset,
    extend=lambda state, asset: replace(state, asset=asset),
    scene=_scene,
    folders=("scene",),
    reads_back=True,  # the scene format rounds v and orders keys: an export must not depend on an interruption
)
EXPORT: Stage[RunState, None] = Stage(
    name="export",
    settings=lambda state: [list(state.config.export), state.config.exporter],
    compute=_export,
    save=lambda state, value, folder: None,
    load=lambda state, folder: None,
    extend=lambda state, value: state,
    folders=("exports",),
)

STAGES: tuple[Stage[RunState, Any], ...] = (INITIALIZER, GEOMETRY, ATLAS, REFLECTANCE, BAKE, EXPORT)
"""In the order of a run."""
