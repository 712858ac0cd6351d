"""The run, from a folder of photographs to an asset and its files (DESIGN section 5)."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hir_core.capture import Capture
from hir_core.capture.capture_size import size_of
from hir_core.capture.capture_store import (
    file_hash,
    fingerprint,
    read_cameras,
    restore_capture,
    save_capture,
    write_cameras,
)
from hir_core.capture.pixel_cache import DEFAULT_BYTES, PixelCache
from hir_core.config import RunConfig, load_config
from hir_core.errors import CaptureError
from hir_core.intake.reader_lookup import find_reader, read_capture
from hir_core.plugins.manager import PluginManager
from hir_core.run.determinism import determinism
from hir_core.run.memory_plan import plan_memory
from hir_core.run.run_directory import STAGES, RunDirectory, claimed_run
from hir_core.run.session import Session, StopRun, check_until, resolve_device
from hir_core.run.stage_context import StageContext
from hir_core.stages.initialization import files_read, initialize

if TYPE_CHECKING:
    from hir_exporters.asset import Asset

    from hir_core.plugins.progress import Progress
    from hir_core.scene import Scene
    from hir_core.stages.export.export_rerendering import Rerender


@dataclass(frozen=True)
class Run:
    """What `reconstruct` returns."""

    directory: RunDirectory
    reused: tuple[str, ...]
    """Stages that were read from an earlier run."""

    @property
    def path(self) -> Path:
        """The run's folder."""
        return self.directory.path

    @property
    def asset(self) -> Asset:
        """The finished asset; an error where the run stopped before `bake`."""
        from hir_exporters.scene_format import load_scene

        return load_scene(self.directory.scene)


def reconstruct(
    capture: str | Path,
    run: str | Path,
    *,
    preset: str = "",
    config: RunConfig | str | Path | None = None,
    assignments: Sequence[str] = (),
    device: str | None = None,
    resume: bool = False,
    until: str | None = None,
    plugins: PluginManager | None = None,
    on_progress: Callable[[Progress], None] | None = None,
    on_message: Callable[[str], None] | None = None,
    **overrides: Any,
) -> Run:
    """Turns the photographs of `capture` into an asset in the folder `run`.

    `config` is a TOML file or a finished `RunConfig`; `assignments` are `key=value` as after `--set`; further keyword
    arguments are top-level settings. `on_message` gets one sentence at a time. Raises `HirError` with one sentence.
    """
    last = check_until(until)
    plugins = plugins or PluginManager.discover()
    if not isinstance(config, RunConfig):
        file = None if config is None else Path(config)
        config = load_config(plugins, preset, file, assignments, device=device, **overrides)
    found = resolve_device(config.device)
    find_reader(Path(capture), plugins, config.reader)  # before a folder is made for a capture that nobody can read
    with claimed_run(run, resume) as directory, determinism(config.deterministic):
        session = Session(config, plugins, directory, found, last, on_progress, on_message)
        with contextlib.suppress(StopRun):
            run_stages(Path(capture), session)
        session.finish()
        if directory.scene.is_dir():
            from hir_core.report import refresh_page, write_report

            if set(session.reused) >= set(STAGES[:-1]) and (directory.report / "views.json").exists():
                refresh_page(directory, plugins)
            else:
                write_report(directory, plugins, on_message=on_message)
    return Run(directory, tuple(session.reused))


def run_stages(path: Path, session: Session) -> Asset:
    """A folder ─ reader ─► capture ─ initializers ─► mesh ─ fits ─► scene ─ bake ─► asset ─► files."""
    capture, names, photographs = open_capture(path, session)
    config = session.config
    capture, scene = initializer_stage(capture, session)
    write_cameras(session.directory.cameras, capture.transformed(asset_from_working(session)), names)
    capture = photographs.undistort(capture)
    scene = geometry_stage(scene, capture, session)
    scene = atlas_stage(scene, capture, session)
    scene = reflectance_stage(scene, capture, session)
    asset = bake_stage(scene, capture, session)
    return export_stage(asset, config, session)


def open_capture(path: Path, session: Session) -> tuple[Capture, list[str], PixelCache]:
    """The train split, decoded at most once, and the names of its photographs; starts the session's records.

    From here on the session's settings are those that fit into the memory that is allowed.
    """
    capture = read_capture(path, "train", session.plugins, session.config.reader)
    if not capture.views:
        raise CaptureError(f"{path} holds no photographs to fit; is it the folder of a capture?")
    session.allow(plan_memory(session.config, session.plugins, size_of(capture)))
    mark = fingerprint(capture)
    session.key = mark
    session.start(
        {
            "path": str(path.resolve()),
            "name": path.resolve().name,
            "reader": capture.reader,
            "split": capture.split,
            "views": len(capture.views),
            "fingerprint": mark,
        }
    )
    photographs = PixelCache(session.memory.cache_bytes if session.memory is not None else DEFAULT_BYTES)
    return photographs.wrap(capture), [view.name for view in capture.views], photographs


def initializer_stage(capture: Capture, session: Session) -> tuple[Capture, Scene]:
    """Cameras, masks and a first mesh, in the working frame: the object centred at the origin, of radius 1."""
    from hir_core.scene.scene_store import load_stage_scene, save_stage_scene

    config, plugins = session.config, session.plugins

    def compute(context: StageContext) -> tuple[tuple[Capture, Scene], dict[str, Any]]:
        return initialize(capture, config, context)

    def save(value: tuple[Capture, Scene], folder: Path) -> None:
        save_capture(value[0], folder)
        save_stage_scene(value[1], folder / "scene")

    def load(folder: Path) -> tuple[Capture, Scene]:
        return restore_capture(capture, folder), load_stage_scene(folder / "scene", session.device)

    chain = config.initializers if config.initializers != "auto" else plugins.suggest_initializers(capture)
    read = files_read(chain, capture, config, plugins)
    settings = [list(chain), config.masks, config.initializer, config.mask_source, read]
    fitted, scene = session.stage("initializer", settings, compute, save, load, scene_of=lambda value: value[1])
    report = session.document["stages"]["initializer"]["report"]
    session.document["asset_from_working"] = np.linalg.inv(np.array(report["working_from_asset"])).tolist()
    session.document["asset_from_source"] = (
        np.array(session.document["asset_from_working"]) @ fitted.world_from_source
    ).tolist()
    return fitted, scene


def geometry_stage(scene: Scene, capture: Capture, session: Session) -> Scene:
    """The mesh that explains the masks."""
    settings = session.config.geometry
    if not settings.enabled:
        return _pass_through("geometry", scene, session)
    from hir_core.stages.geometry.geometry_fit import fit_geometry

    used = session.config.geometry_renderer.get(settings.renderer, {})
    return _scene_stage(
        "geometry", [asdict(settings), used], session, lambda context: fit_geometry(scene, capture, settings, context)
    )


def atlas_stage(scene: Scene, capture: Capture, session: Session) -> Scene:
    """Texture coordinates, and the photographs' colours baked where the stage can."""
    from hir_core.stages.atlas import unwrap

    settings = session.config.atlas
    return _scene_stage("atlas", settings, session, lambda context: unwrap(scene, capture, settings, context))


def reflectance_stage(scene: Scene, capture: Capture, session: Session) -> Scene:
    """Material and light that explain the photographs."""
    settings = session.config.reflectance
    if not settings.enabled:
        return _pass_through("reflectance", scene, session)
    from hir_core.stages.reflectance.reflectance_fit import fit_reflectance

    light = Path(settings.known_environment.rpartition("*")[0] or settings.known_environment)
    known = file_hash(light) if settings.known_environment else ""
    used = [asdict(settings), known, session.config.reflectance_renderer]
    return _scene_stage(
        "reflectance", used, session, lambda context: fit_reflectance(scene, capture, settings, context)
    )


def bake_stage(scene: Scene, capture: Capture, session: Session) -> Asset:
    """The asset in the place and scale of the capture's own files (+Y up), written to `scene/`."""
    from hir_exporters.light.environment_map import FIRST_VIEW_KEY
    from hir_exporters.scene_format import load_scene, save_scene

    from hir_core.scene.asset_conversion import bake
    from hir_core.scene.frames import move_scene

    name = str(session.document["capture"]["name"])

    def compute(_: StageContext) -> tuple[Asset | None, dict[str, Any]]:
        from hir_exporters.asset import describe

        facts = provenance(session)
        if scene.environment is not None and scene.environment.frame == "camera":
            facts[FIRST_VIEW_KEY] = capture.cameras[0].world_to_camera[:3, :3].T.tolist()
        asset = bake(move_scene(scene, asset_from_working(session)), name=name, provenance=facts)
        return asset, describe(asset)

    def save(asset: Asset | None, _: Path) -> None:
        assert asset is not None
        save_scene(asset, session.directory.scene)

    session.stage("bake", name, compute, save, lambda _: load_scene(session.directory.scene), lambda _: scene)
    # always as the files have it (last bits of v, order of keys): an export may not depend on an interruption
    return load_scene(session.directory.scene)


def export_stage(asset: Asset, config: RunConfig, session: Session) -> Asset:
    """The asset in every format of the settings, in `exports/`."""
    from hir_exporters.files.atomic import atomic_directory

    from hir_core.stages.export.asset_export import export_asset
    from hir_core.stages.export.export_verification import verify_export

    def is_light(name: str) -> bool:
        return "environment" in session.plugins.find("exporter", name).component.traits

    def compute(context: StageContext) -> tuple[Asset, dict[str, Any]]:
        formats = [name for name in config.export if asset.environment is not None or not is_light(name)]
        if len(formats) < len(config.export):
            context.warn("the asset has no light, so its light is not exported")
        # as a whole: files of formats that are no longer asked for do not stay
        verified = {}
        with atomic_directory(session.directory.exports) as place:
            reports = export_asset(asset, formats, place, session.plugins, config.exporter) if formats else {}
            rerender = _rerender(asset, session)
            for name, report in reports.items():
                verified[name] = verify_export(report, asset, config.exporter.get(name), rerender, "no light")
        for name, report in reports.items():
            for warning in (*report.warnings, *verified[name].warnings):
                context.warn(f"{name}: {warning}")
        return asset, {
            name: {
                "files": [file.name for file in report.files],
                "residuals": dict(report.residuals),
                "verified": dict(verified[name].report),
            }
            for name, report in reports.items()
        }

    settings = [list(config.export), config.exporter]
    return session.stage("export", settings, compute, lambda *_: None, lambda _: asset, lambda _: None)


def _rerender(asset: Asset, session: Session) -> Rerender | None:
    """Small pictures of few paths: what an export costs shows in them, and they take seconds."""
    from hir_core.stages.export.export_rerendering import Rerender

    cameras = read_cameras(session.directory.cameras)
    if asset.environment is None or not cameras:
        return None
    bounces = session.document["stages"]["reflectance"]["report"].get("bounces")
    working_from_asset = np.linalg.inv(asset_from_working(session))
    return Rerender(asset, cameras, working_from_asset, session.plugins, bounces=bounces)


def asset_from_working(session: Session) -> np.ndarray:
    """4×4 similarity from the frame of the fits to that of the asset."""
    return np.array(session.document["asset_from_working"], dtype=np.float64)


def provenance(session: Session) -> dict[str, Any]:
    """What the asset's own files say of where they come from; nothing that differs between two equal runs."""
    document = session.document
    return {
        "generator": f"hir {document['versions'].get('hir', '')}".strip(),
        "capture": document["capture"]["name"],
        "fingerprint": document["capture"]["fingerprint"],
        "preset": session.config.preset,
        "seed": session.config.seed,
    }


def _scene_stage(
    name: str, settings: Any, session: Session, compute: Callable[[StageContext], tuple[Scene, Any]]
) -> Scene:
    """A stage whose result is a scene alone."""
    from hir_core.scene.scene_store import load_stage_scene, save_stage_scene

    return session.stage(
        name,
        settings,
        compute,
        save=lambda scene, folder: save_stage_scene(scene, folder / "scene"),
        load=lambda folder: load_stage_scene(folder / "scene", session.device),
    )


def _pass_through(name: str, scene: Scene, session: Session) -> Scene:
    """A stage that the settings leave out."""
    return _scene_stage(name, "left out", session, lambda _: (scene, {"enabled": False}))
