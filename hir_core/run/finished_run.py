"""A finished run, read from its folder: its scene in the working frame, its cameras, its capture in that frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from hir_exporters.scene_format import load_scene

from hir_core.capture import Camera, Capture
from hir_core.capture.coordinate_frames import CoordinateFrames
from hir_core.capture.photograph_exposures import EQUAL_EXPOSURES, PhotographExposures
from hir_core.config import RunConfig
from hir_core.errors import CaptureError, InputError
from hir_core.intake.reader_lookup import find_reader, read_capture
from hir_core.run.capture_store import read_cameras, read_exposures, restore_capture
from hir_core.run.device import resolve_device
from hir_core.run.run_directory import RunDirectory
from hir_core.scene import EnvironmentMap, Scene
from hir_core.scene.asset_conversion import scene_from_asset
from hir_core.scene.frames import move_scene
from hir_core.scene.scene_store import load_take_radiance

if TYPE_CHECKING:
    from hir_core.plugins.manager import PluginManager


@dataclass(frozen=True)
class FinishedRun:
    """A run whose scene is complete. `scene` is in the working frame: object at the origin, radius 1."""

    directory: RunDirectory
    document: Mapping[str, Any]
    """run.json."""
    scene: Scene
    frames: CoordinateFrames

    @property
    def bounces(self) -> int | None:
        """Reflections between parts of the object that the fit modelled; None where run.json has no number."""
        report = self.document.get("stages", {}).get("reflectance", {}).get("report", {})
        bounces = report.get("bounces")
        return bounces if isinstance(bounces, int) else None

    @property
    def takes(self) -> list[str]:
        """Names of the takes that the fit gave a light each; empty for one light."""
        takes = self.document.get("stages", {}).get("reflectance", {}).get("report", {}).get("takes")
        return [str(take) for take in takes] if isinstance(takes, list) else []

    @property
    def capture_path(self) -> Path:
        """The folder of photographs that the run was made from."""
        return Path(self.document["capture"]["path"])

    @property
    def exposures(self) -> PhotographExposures:
        """The exposures of the photographs that the fit used."""
        path = self.directory.stage("reflectance") / "model.json"
        return read_exposures(path) if path.exists() else EQUAL_EXPOSURES

    def cameras(self) -> dict[str, Camera]:
        """The cameras of the run's undistorted photographs by view name, in the working frame."""
        cameras = read_cameras(self.directory.cameras)
        return {name: camera.pinhole().transformed(self.frames.working_from_asset) for name, camera in cameras.items()}

    def read_split(self, path: Path, split: str, plugins: PluginManager) -> Capture:
        """A split of a capture, moved from the axes of its files to the working frame; it may have no views."""
        reader = self._reader_name if path == self.capture_path else "auto"
        capture = read_capture(path, split, plugins, reader)
        return capture.transformed(self.frames.working_from_source @ np.linalg.inv(capture.world_from_source))

    def views_of_split(self, path: Path, split: str, plugins: PluginManager) -> Capture:
        """As `read_split`; the train split of the run's own capture has the cameras and masks that the run computed.

        All views of that capture have the exposures that the fit used, where they have any.

        `CaptureError` where the split has no views.
        """
        if split != "train" or path.resolve() != self.capture_path.resolve():
            capture = self.read_split(path, split, plugins)
        else:
            _, reader = find_reader(path, plugins, self._reader_name)
            capture = restore_capture(reader.read(path, split), self.directory.stage("initializer"))
        if not capture.views:
            raise CaptureError(f"{path}: split {split!r} has no views")
        return self.exposures.applied_to(capture) if path.resolve() == self.capture_path.resolve() else capture

    @property
    def report_side(self) -> int:
        """The setting `report_side`; `InputError` where run.json holds no number of pixels."""
        side = self.document.get("settings", {}).get("report_side", RunConfig.report_side)
        if not isinstance(side, int) or side < 1:
            raise InputError(f"{self.directory.path / 'run.json'}: report_side is {side!r}, not a number of pixels")
        return side

    def with_light(self, light: EnvironmentMap) -> Scene:
        """The scene under another light, which is in the working frame."""
        return replace(self.scene, environment=light, take_radiance={})

    @property
    def _reader_name(self) -> str:
        return str(self.document["capture"].get("reader", "auto"))


def open_finished_run(directory: RunDirectory, device: str | None = None) -> FinishedRun:
    """Reads run.json and scene/; `InputError` where the run has no finished scene.

    Without `device` the scene is on the device that the run computed on, if PyTorch has it here, else on the processor.
    """
    document = directory.read_run()
    if not directory.has_finished_scene:
        earlier = ": its latest call ended before the stage bake, and scene/ is of an earlier one"
        raise InputError(
            f"{directory.path} has no finished scene{earlier if directory.scene.is_dir() else ''}; "
            "finish it with: hir reconstruct … --resume"
        )
    frames = _frames(document, str(directory.path / "run.json"))
    scene = move_scene(scene_from_asset(load_scene(directory.scene)), frames.working_from_asset)
    run = FinishedRun(directory, document, scene, frames)
    lights = load_take_radiance(directory.stage("reflectance") / "scene")
    if missing := [take for take in run.takes if take not in lights]:
        raise InputError(
            f"{directory.stage('reflectance')} lacks the light of the take {missing[0]!r}; finish the run again with "
            "--resume"
        )
    return replace(run, scene=replace(scene, take_radiance=lights).to(device or _own_device(directory)))


def _own_device(directory: RunDirectory) -> str:
    try:
        computed_on = directory.read_timings()["machine"]["device"]
    except (InputError, KeyError, TypeError):
        return "cpu"  # a damaged timings.json does not keep a run from being shown
    return resolve_device("auto") if computed_on == "cuda" else "cpu"


def _frames(document: Mapping[str, Any], source: str) -> CoordinateFrames:
    """The frames that the initializer stage reports."""
    try:
        entry = document["stages"]["initializer"]["report"]["frames"]
    except (KeyError, TypeError) as error:
        raise InputError(f"{source} holds no coordinate frames; finish the run with --resume") from error
    return CoordinateFrames.from_document(entry, source)
