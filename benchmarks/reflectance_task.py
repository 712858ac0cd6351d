"""The task of `hir bench reflectance` for studies: material and light on a capture's true mesh, at half the size."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

from hir_core.capture import Capture
from hir_core.config import ReflectanceSettings
from hir_core.intake.reader_lookup import read_capture
from hir_core.plugins.manager import PluginManager
from hir_core.scene import Scene
from hir_core.stages.reflectance.initial_material_and_light import initial_scene
from hir_plugins.commands.bench.inputs.bench_captures import decode_images, true_scene
from hir_plugins.commands.bench.inputs.scene_evaluator import SceneEvaluator
from hir_plugins.commands.bench.suites.reflectance_fits import DOWNSAMPLE, FITTED_MODEL


@dataclass(frozen=True)
class Task:
    """Input and evaluation of a fit; rows are printed as Markdown."""

    path: Path
    plugins: PluginManager
    train: Capture
    start: Scene
    evaluator: SceneEvaluator

    def row(self, name: str, seconds: float | None, shown: Scene) -> None:
        """Evaluates a scene and prints its row."""
        errors = self.evaluator(shown, FITTED_MODEL.bounces)
        relit = ", ".join(f"{value:.1f}" for key, value in errors.items() if key.startswith("relight"))
        unseen = f"{errors['unseen dB']:.1f} / {errors['frame dB']:.1f}"
        print(f"| {name} | {'–' if seconds is None else f'{seconds:.0f}'} | {unseen} | {relit} |", flush=True)


def task_from_arguments(description: str | None) -> Task:
    """The task of the capture that the command line names; prints the table's header."""
    task = task_of(capture_argument(description), DOWNSAMPLE)
    print("| | seconds | unseen, object / frame | relit, frame, scaled |\n|---|---|---|---|")
    return task


def capture_argument(description: str | None) -> Path:
    """The only argument of these programs."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("capture", type=Path)
    path: Path = parser.parse_args().capture
    return path


def task_of(path: Path, downsample: int) -> Task:
    """The task of a capture whose true mesh is known."""
    plugins = PluginManager.discover()
    train = decode_images(read_capture(path, "train", plugins))
    scene = true_scene(path, train)
    if scene is None:
        raise SystemExit(f"{path} has no true mesh")
    start = initial_scene(scene, train, ReflectanceSettings())
    return Task(path, plugins, train, start, SceneEvaluator(path, plugins, downsample))
