"""What the plugin system costs: discovery, and hooks in a run."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hir_core.pipeline import Run
from hir_core.plugins import hookimpl
from hir_core.plugins.manager import PluginManager
from tests.fixtures.runs import make_tiny

ROOT = Path(__file__).resolve().parents[3]
PLUGINS = 200
RATIO = 2.0
"""Processor time that plugins add to `hir --help`, over what Python itself takes to find and import the same ones."""
TRIES = 3

PLUGIN = '''
from dataclasses import dataclass
from hir_core.plugins import Component, hookimpl

@dataclass(frozen=True)
class Options:
    """Of term {i}."""
    strength: float = 1.0
    """Factor of the term."""

@hookimpl
def hir_register_regularizers():
    return [Component("term_{i}", "crowd_{i}:Term", Options, "A term.")]
'''


HELP = """
import contextlib, io, sys, time
sys.path.insert(0, {folder!r})
from hir_core.cli import main
with contextlib.redirect_stdout(io.StringIO()) as said, contextlib.suppress(SystemExit):
    main(["--help"])
spent = time.process_time()
assert "reconstruct" in said.getvalue() and "batch" in said.getvalue()
assert ("crowd_{last}" in sys.modules) == {crowded}
print(spent)
"""
PLAIN_PYTHON = """
import sys, time
sys.path.insert(0, {folder!r})
from hir_core.plugins import Component
from importlib.metadata import entry_points
before = time.process_time()
for entry_point in entry_points(group="hir"):
    entry_point.load()
print(time.process_time() - before)
"""


@pytest.mark.slow
def test_200_plugins_add_to_the_help_at_most_twice_what_python_takes_to_import_them(tmp_path: Path) -> None:
    """Processor time, the least of some processes, for the machine does other things too."""
    crowd, empty = tmp_path / "crowd", tmp_path / "empty"
    for folder in (crowd, empty):
        folder.mkdir()
    for i in range(PLUGINS):
        (crowd / f"crowd_{i}.py").write_text(PLUGIN.format(i=i))
        info = crowd / f"crowd_{i}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: crowd-{i}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[hir]\ncrowd = crowd_{i}\n")
    # what measures coverage in child processes, too, would be measured with it
    plain = {name: value for name, value in os.environ.items() if not name.startswith("COVERAGE")}
    best: dict[tuple[str, Path], float] = {}
    for _ in range(TRIES):
        for program in (HELP, PLAIN_PYTHON):
            for folder in (crowd, empty):
                code = program.format(folder=str(folder), crowded=folder == crowd, last=PLUGINS - 1)
                done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=plain)
                assert done.returncode == 0, done.stderr
                spent = float(done.stdout)
                best[program, folder] = min(best.get((program, folder), spent), spent)
    added, alone = (best[program, crowd] - best[program, empty] for program in (HELP, PLAIN_PYTHON))
    assert 0 < added <= RATIO * alone, f"hir --help {added:.3f} s, Python alone {alone:.3f} s"


def test_plugins_and_their_descriptors_import_no_numpy(tmp_path: Path) -> None:
    code = (
        "import sys; from hir_core.plugins.manager import PluginManager; manager = PluginManager.discover()\n"
        "assert not manager.problems, manager.problems\n"
        "assert 'numpy' not in sys.modules, 'a plugin.py imports numpy'"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


class Counting:
    """An observer that counts."""

    def __init__(self) -> None:
        self.calls: Counter[str] = Counter()
        self.steps = 0

    @hookimpl
    def hir_run_started(self) -> None:
        self.calls["hir_run_started"] += 1

    @hookimpl
    def hir_progress(self, progress: Any) -> None:
        self.calls["hir_progress"] += 1
        self.steps += max((len(values) for values in progress.scalars.values()), default=0)

    @hookimpl
    def hir_stage_finished(self, stage: str) -> None:
        self.calls["hir_stage_finished"] += 1

    @hookimpl
    def hir_suggest_initializers(self, capture: Any) -> None:
        self.calls["hir_suggest_initializers"] += 1

    @hookimpl
    def hir_gltf_document(self, document: Any) -> None:
        self.calls["hir_gltf_document"] += 1


@pytest.mark.slow
def test_no_hook_runs_in_an_inner_loop(tmp_path: Path, quick: Callable[..., Run]) -> None:
    """A run of hundreds of steps calls hooks once a stage, and progress at most four times a second."""
    counting = Counting()
    plugins = PluginManager.discover()
    plugins.register(counting, "test", "")
    assert plugins.problems == []
    capture = make_tiny(tmp_path / "capture")
    steps = ("geometry.iterations=300", "reflectance_renderer.transport_ggx.steps=100")
    term = "reflectance.regularizers={ total_variation = { weight = 1.0 } }"
    run = quick(capture, tmp_path / "run", *steps, term, 'export=["glb"]', plugins=plugins)
    timings = run.directory.read_timings()["stages"]
    assert counting.calls["hir_run_started"] == 1
    assert counting.calls["hir_stage_finished"] == len(timings) == 6
    assert counting.calls["hir_gltf_document"] == 1
    assert counting.calls["hir_suggest_initializers"] <= 3
    assert counting.steps >= 300, "the scalars of every step of the geometry stage arrive"
    most = sum(4 * stage["seconds"] + 2 for stage in timings.values())
    assert counting.calls["hir_progress"] <= most, counting.calls
    if counting.steps > 16 * (timings["geometry"]["seconds"] + timings["reflectance"]["seconds"]):
        # where a step takes a quarter of a second, four calls a second are a call each step
        assert counting.calls["hir_progress"] < counting.steps / 4


def test_hooks_are_called_from_few_places() -> None:
    """The session at stage boundaries, the listener in blocks, start-up, `hir check`, export, two benchmarks."""
    callers = set()
    for file in [*(ROOT / "hir_core").rglob("*.py"), *(ROOT / "hir_plugins").rglob("*.py")]:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
                continue
            edits = node.func.attr == "edit" and "plugins" in ast.unparse(node.func.value)
            if edits or node.func.attr in ("notify", "suggest_initializers"):
                callers.add(file.relative_to(ROOT).as_posix())
    assert callers == {
        "hir_plugins/commands/bench/suites/initializers_suite.py",
        "hir_plugins/commands/bench/suites/shape_suite.py",
        "hir_core/stages/export/asset_export.py",
        "hir_core/stages/initialization.py",
        "hir_core/cli/check_command.py",
        "hir_core/run/progress_listener.py",
        "hir_core/pipeline.py",
        "hir_core/run/stage_runner.py",
    }
