"""The built-in observers: what they write, where, and nothing where they are not asked for."""

from __future__ import annotations

import ast
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.textures.image_files import read_ldr

from hir_core.config import RunConfig
from hir_core.pipeline import Run
from hir_core.plugins.manager import PluginManager
from hir_core.plugins.progress import Progress
from tests.fixtures.runs import make_tiny

ROOT = Path(__file__).resolve().parents[3]


def manager_with(table: dict[str, dict[str, object]], folder: Path) -> PluginManager:
    manager = PluginManager.discover()
    manager.notify("hir_run_started", config=RunConfig(observers=table), run_folder=folder)
    return manager


def test_nothing_is_written_where_no_table_asks(tmp_path: Path) -> None:
    manager = manager_with({}, tmp_path)
    manager.notify("hir_progress", progress=Progress("geometry", 1, 1, 0.1, {"loss": np.ones(1)}))
    manager.notify("hir_stage_finished", stage="geometry", scene=None, report={"loss": 1.0})
    assert manager.problems == [] and list(tmp_path.iterdir()) == []


def test_tensorboard_holds_every_scalar_at_its_step(tmp_path: Path) -> None:
    reading = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    pytest.importorskip("torch")
    manager = manager_with({"tensorboard": {}}, tmp_path)
    for end in (3, 6):
        values = 11.0 - np.arange(end - 2, end + 1)
        manager.notify("hir_progress", progress=Progress("geometry", end, 6, 0.1, {"loss": values}))
    manager.notify("hir_stage_finished", stage="geometry", scene=None, report={"iou": 0.5, "name": "x", "held": True})
    assert manager.problems == []
    events = reading.EventAccumulator(str(tmp_path / "tensorboard" / "geometry"))
    events.Reload()
    assert sorted(events.Tags()["scalars"]) == ["loss", "report/iou"]
    assert [(event.step, event.value) for event in events.Scalars("loss")] == [(s, 11.0 - s) for s in range(1, 7)]


@pytest.mark.parametrize("kind", ["colours at vertices", "texture"])
def test_a_preview_shows_the_object_in_its_colours(kind: str, tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")
    from dataclasses import replace

    from hir_core.scene import Scene
    from hir_core.testing.scenes import bumpy_scene, sphere

    red = torch.tensor([0.8, 0.02, 0.02])
    if kind == "texture":
        scene = bumpy_scene()
        assert scene.material is not None
        scene = replace(scene, material=replace(scene.material, diffuse_albedo=red.expand(8, 8, 3)))
    else:
        mesh = sphere()
        scene = Scene(replace(mesh, vertex_colors=red.expand(len(mesh.positions), 3)))
    manager = manager_with({"previews": {"size": 48, "sides": 3}}, tmp_path)
    manager.notify("hir_stage_finished", stage="atlas", scene=scene, report={})
    assert manager.problems == []
    picture = read_ldr(tmp_path / "previews" / "atlas.png")
    assert picture.shape[:2] == (48, 144)
    middle, corner = picture[24, 24, :3], picture[1, 1, :3]
    assert middle[0] > 3 * middle[1] and middle[0] > 0.4
    assert corner.min() > 0.99, "nothing but white beside the object"


def test_progress_is_a_file_for_other_programs(tmp_path: Path) -> None:
    """The first and the last step of each stage are always written; those between them once in an interval."""
    manager = manager_with({"progress_file": {"interval_seconds": 3600}}, tmp_path)
    written = tmp_path / "progress.json"

    def report(stage: str, step: int, scalars: dict[str, np.ndarray], **more: object) -> dict[str, object]:
        manager.notify("hir_progress", progress=Progress(stage, step, 8, 2.0, scalars, **more))  # type: ignore[arg-type]
        return dict(json.loads(written.read_text()))

    first = report("geometry", 2, {"iou": np.array([0.5, 0.75])}, message="level 1")
    assert first == {
        **{"stage": "geometry", "step": 2, "steps": 8, "seconds": 2.0, "seconds_left": 6.0},
        **{"error": "iou 0.75", "message": "level 1"},
    }
    assert report("geometry", 4, {"iou": np.array([0.8])}) == first
    last = report("geometry", 8, {})
    assert (last["step"], last["seconds_left"], last["error"]) == (8, 0.0, "iou 0.8"), "the latest known error"
    assert report("atlas", 1, {})["error"] == "", "that of another stage"
    manager.notify("hir_run_started", config=RunConfig(observers={"progress_file": {}}), run_folder=tmp_path)
    assert manager.problems == [] and not written.exists()


def test_observers_use_nothing_private() -> None:
    files = list((ROOT / "hir_plugins" / "observers").glob("*.py"))
    assert len(files) >= 4
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("hir_"):
                assert all(not alias.name.startswith("_") for alias in node.names)
            if isinstance(node, ast.Attribute) and node.attr.startswith("_") and not node.attr.startswith("__"):
                assert ast.unparse(node.value) == "self", f"{file.name}: {ast.unparse(node)}"


@pytest.mark.slow
def test_both_watch_a_whole_run(tmp_path: Path, quick: Callable[..., Run]) -> None:
    capture = make_tiny(tmp_path / "capture")
    run = quick(capture, tmp_path / "run", "observers.tensorboard={}", "observers.previews={ size = 64 }")
    previews = {file.stem for file in (run.path / "previews").iterdir()}
    assert previews == {"initializer", "geometry", "atlas", "reflectance", "bake"}
    assert any((run.path / "tensorboard" / "geometry").iterdir())
    assert run.directory.read_run()["plugin_problems"] == []
