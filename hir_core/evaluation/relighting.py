"""Which light an evaluation is under: the fitted one, the split's own, or one that is named."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hir_core.capture import Array, Capture, EnvironmentSource
from hir_core.errors import InputError
from hir_core.intake.reader_lookup import find_reader
from hir_core.rendering.reference_renderer import OpenRun, light_of, parse_light, same_light

if TYPE_CHECKING:
    from hir_core.plugins.manager import PluginManager
    from hir_core.scene import Scene


def lit_scene(
    run: OpenRun, path: Path, capture: Capture, relight: str, plugins: PluginManager, device: str = "cpu"
) -> tuple[Scene, dict[str, Any]]:
    """The scene under the light that is asked for, and what that light is.

    `relight` is `FILE` or `FILE*STRENGTH`, in the capture's axes; without it the split's own light where it differs
    from train's, else the fitted one.
    """
    source = capture.environment
    if relight:
        file, strength = parse_light(relight)
        axes = _environment_axes(path, capture, run, plugins)
        source = EnvironmentSource(file, strength, axes)
    elif source is None or _is_training_light(path, source, run, plugins):
        return run.scene, {"fitted": True}
    if source.path.suffix.lower() not in (".hdr", ".exr"):
        raise InputError(f"{source.path}: a light is a lat-long .hdr or .exr file")
    light = light_of(source, capture.world_from_source, device)
    return run.lit_by(light), {"fitted": False, "file": source.path.name, "strength": source.strength}


def _environment_axes(path: Path, capture: Capture, run: OpenRun, plugins: PluginManager) -> Array:
    """3×3 of `EnvironmentSource`: as the split or train says; the asset's axes where a capture names no light."""
    if capture.environment is not None:
        return capture.environment.source_from_environment
    _, reader = find_reader(path, plugins)
    train = reader.read(path, "train").environment if "train" in reader.splits(path) else None
    if train is not None:
        return train.source_from_environment
    linear = capture.world_from_source[:3, :3]
    return np.asarray(linear.T / np.cbrt(np.linalg.det(linear)))


def _is_training_light(path: Path, source: EnvironmentSource, run: OpenRun, plugins: PluginManager) -> bool:
    _, reader = find_reader(path, plugins)
    if "train" not in reader.splits(path):
        return False
    return same_light(source, reader.read(path, "train").environment)
