"""The light of an evaluation: the fitted one, the split's own, or a file that the user names."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hir_core.capture import Array, Capture, EnvironmentSource
from hir_core.errors import InputError
from hir_core.files.light_setting import parse_light_file
from hir_core.intake.reader_lookup import find_reader
from hir_core.rendering.light_files import is_same_light, load_light
from hir_core.run.finished_run import FinishedRun

if TYPE_CHECKING:
    from hir_core.plugins.manager import PluginManager
    from hir_core.scene import Scene


def lit_scene(
    run: FinishedRun, path: Path, capture: Capture, relight: str, plugins: PluginManager, device: str = "cpu"
) -> tuple[Scene, dict[str, Any]]:
    """The scene under the light of the evaluation, and a JSON-able description of that light.

    `relight` is `FILE` or `FILE*STRENGTH`, in the capture's axes. Where it is empty, the light is the split's own if
    that differs from the light of the train split, else the fitted light.
    """
    source = capture.environment
    if relight:
        file, strength = parse_light_file(relight)
        source = EnvironmentSource(file, strength, _environment_axes(path, capture, plugins))
    elif source is None or _is_training_light(path, source, plugins):
        return run.scene, {"fitted": True}
    if source.path.suffix.lower() not in (".hdr", ".exr"):
        raise InputError(f"{source.path}: a light must be a lat-long .hdr or .exr file")
    light = load_light(source, capture.world_from_source, device)
    return run.with_light(light), {"fitted": False, "file": source.path.name, "strength": source.strength}


def training_light(path: Path, plugins: PluginManager) -> EnvironmentSource | None:
    """The light of the train split; None where the capture names none."""
    _, reader = find_reader(path, plugins)
    return reader.read(path, "train").environment if "train" in reader.splits(path) else None


def _environment_axes(path: Path, capture: Capture, plugins: PluginManager) -> Array:
    """3×3 of `EnvironmentSource`, from the split or the train split; the asset's axes where neither names a light."""
    if capture.environment is not None:
        return capture.environment.source_from_environment
    train = training_light(path, plugins)
    if train is not None:
        return train.source_from_environment
    linear = capture.world_from_source[:3, :3]
    return np.asarray(linear.T / np.cbrt(np.linalg.det(linear)))


def _is_training_light(path: Path, source: EnvironmentSource, plugins: PluginManager) -> bool:
    _, reader = find_reader(path, plugins)
    return "train" in reader.splits(path) and is_same_light(source, training_light(path, plugins))
