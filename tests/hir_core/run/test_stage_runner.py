"""Stages are reused when nothing they depend on changed, and done again when something did."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hir_core.config import RunConfig
from hir_core.errors import StageError
from hir_core.plugins import Component
from hir_core.plugins.manager import PluginManager, Registered
from hir_core.plugins.progress import Progress
from hir_core.run.progress_listener import ProgressListener, read_curves
from hir_core.run.run_directory import RunDirectory
from hir_core.run.run_records import RunRecords
from hir_core.run.stage import Stage, StageResult
from hir_core.run.stage_context import StageContext
from hir_core.run.stage_runner import StageRunner

NAMES = ("initializer", "geometry", "atlas")


@dataclass(frozen=True)
class WordReport:
    """Report of a stage that appends a letter."""

    length: int


def test_run_json_names_a_plugin_file_without_a_version(tmp_path: Path) -> None:
    plugins = PluginManager()
    for name, version in (("tint", ""), ("glow", "1.0")):
        owner = f"{name}.py" if not version else f"hir-{name}"
        registered = Registered("regularizer", Component(name, "m:T", config=None, summary="A term."), owner, version)
        plugins = plugins.with_component(registered)
    directory = RunDirectory(tmp_path)
    RunRecords(directory, plugins, print).start({"path": "p", "name": "n"}, asdict(RunConfig()), {}, "cpu")
    assert directory.read_run()["plugins"] == ["regularizer glow (hir-glow 1.0)", "regularizer tint (tint.py)"]


class Chain:
    """Three stages that each append a letter to a text; counts what is computed."""

    def __init__(self, folder: Path, config: RunConfig | None = None, key: str = "input") -> None:
        self.messages: list[str] = []
        self.computed: list[str] = []
        directory, plugins, config = RunDirectory(folder), PluginManager(), config or RunConfig()
        self.records = RunRecords(directory, plugins, self.messages.append)
        self.records.start({"path": "somewhere", "name": "it"}, asdict(config), {}, "cpu")
        self.runner = StageRunner(
            plugins,
            directory,
            self.records,
            StageContext(plugins, folder, seed=config.seed),
            {},
            None,
            self.messages.append,
            key,
        )

    def run(self, fail: str = "", **settings: Any) -> str:
        text = ""
        for name in NAMES:
            text = self.runner.run(self._stage(name, settings.get(name, {}), fail), text)
        return text

    def _stage(self, name: str, settings: dict[str, Any], fail: str) -> Stage[str, str]:
        def compute(text: str, context: StageContext) -> StageResult[str]:
            (context.workspace / "checkpoint").write_text(name)
            if name == fail:
                raise StageError("the disk is full")
            self.computed.append(name)
            context.warn(f"{name} is thin")
            return StageResult(text + name[0], WordReport(len(text) + 1))

        def save(text: str, value: str, folder: Path) -> None:
            (folder / "result").write_text(value)

        return Stage(
            name=name,
            settings=lambda text: settings,
            compute=compute,
            save=save,
            load=lambda text, folder: (folder / "result").read_text(),
            extend=lambda text, value: value,
        )


def test_second_run_reuses_every_stage_and_says_so(tmp_path: Path) -> None:
    assert Chain(tmp_path).run() == "iga"
    again = Chain(tmp_path)
    assert again.run() == "iga"
    assert again.computed == [] and again.runner.reused == list(NAMES)
    assert sum("reused" in message for message in again.messages) == 3
    document = RunDirectory(tmp_path).read_run()
    assert document["stages"]["atlas"] == {"report": {"length": 3}, "warnings": ["atlas is thin"]}


@pytest.mark.parametrize(
    ("changed", "done_again"),
    [("initializer", ["initializer", "geometry", "atlas"]), ("geometry", ["geometry", "atlas"]), ("atlas", ["atlas"])],
)
def test_changed_setting_invalidates_exactly_the_stages_that_depend_on_it(
    tmp_path: Path, changed: str, done_again: list[str]
) -> None:
    Chain(tmp_path).run()
    again = Chain(tmp_path)
    again.run(**{changed: {"iterations": 3}})
    assert again.computed == done_again


def test_input_and_seed_invalidate_everything(tmp_path: Path) -> None:
    Chain(tmp_path).run()
    other = Chain(tmp_path, key="other photographs")
    other.run()
    assert other.computed == list(NAMES)
    seeded = Chain(tmp_path, config=replace(RunConfig(), seed=1), key="other photographs")
    seeded.run()
    assert seeded.computed == list(NAMES)


def test_failed_stage_is_done_again_with_what_it_left_and_those_before_are_reused(tmp_path: Path) -> None:
    with pytest.raises(StageError):
        Chain(tmp_path).run(fail="atlas")
    work = RunDirectory(tmp_path).stage("atlas") / "work" / "checkpoint"
    assert work.exists(), "an interrupted stage keeps its checkpoints"
    again = Chain(tmp_path)
    again.run()
    assert again.computed == ["atlas"]


def test_the_times_of_a_resumed_stage_contain_those_of_interrupted_calls(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [0.0]
    monkeypatch.setattr("hir_core.run.stage_runner.time.perf_counter", lambda: now[0])
    monkeypatch.setattr("hir_core.run.stage_runner.processor_seconds", lambda: 2 * now[0])

    class Slow(Chain):
        """`atlas` takes 100 s in each call, and reaches a milestone at the beginning."""

        def _stage(self, name: str, settings: dict[str, Any], fail: str) -> Stage[str, str]:
            stage = super()._stage(name, settings, fail)

            def compute(text: str, context: StageContext) -> StageResult[str]:
                context.report(Progress("atlas", 1, 1, 0.0, milestone="begun"))
                now[0] += 100.0
                return stage.compute(text, context)

            return stage if name != "atlas" else replace(stage, compute=compute)

    for _ in range(2):
        with pytest.raises(StageError):
            Slow(tmp_path).run(fail="atlas")
    again = Slow(tmp_path)
    again.run()
    again.records.finish()
    timings = RunDirectory(tmp_path).read_timings()
    entry = timings["stages"]["atlas"]
    assert (entry["seconds"], entry["processor_seconds"], timings["seconds"]) == (300.0, 600.0, 300.0)
    assert entry["milestones"][0][1] == pytest.approx(200.0, abs=0.1)
    assert "atlas: 300.0 s, 200.0 s of them before it was interrupted" in again.messages
    assert not list(tmp_path.rglob("seconds.json"))
    changed = Slow(tmp_path)
    changed.run(atlas={"texture_size": 512})
    assert RunDirectory(tmp_path).read_timings()["stages"]["atlas"]["seconds"] == 100.0


@pytest.mark.parametrize("stored", ["{", "[]", '{"seconds": 5}', '{"seconds": -1, "processor_seconds": 1}'])
def test_damaged_times_of_an_interrupted_call_are_dropped(tmp_path: Path, stored: str) -> None:
    with pytest.raises(StageError):
        Chain(tmp_path).run(fail="atlas")
    (RunDirectory(tmp_path).stage("atlas") / "work" / "seconds.json").write_text(stored)
    Chain(tmp_path).run()
    assert RunDirectory(tmp_path).read_timings()["stages"]["atlas"]["seconds"] < 5


def test_metrics_stay_until_a_stage_is_computed_again(tmp_path: Path) -> None:
    Chain(tmp_path).run()
    directory = RunDirectory(tmp_path)
    directory.write_run(directory.read_run() | {"metrics": {"test": {"ssim": 0.9}}})
    Chain(tmp_path).run()
    assert directory.read_run()["metrics"] == {"test": {"ssim": 0.9}}
    Chain(tmp_path).run(atlas={"texture_size": 512})
    assert directory.read_run()["metrics"] == {}


def test_later_stages_get_what_load_reads_where_a_stage_asks_for_it(tmp_path: Path) -> None:
    chain = Chain(tmp_path)
    stage = chain._stage("initializer", {}, "")
    rounded = replace(stage, load=lambda text, folder: (folder / "result").read_text().upper(), reads_back=True)
    assert chain.runner.run(rounded, "") == "I"


def test_a_report_must_be_a_dataclass() -> None:
    assert StageResult("", WordReport(2)).report_document() == {"length": 2}
    with pytest.raises(TypeError, match="must be a dataclass, not list"):
        StageResult("", [1]).report_document()


def test_run_json_is_the_same_for_the_same_run_and_timings_hold_the_rest(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        Chain(tmp_path / name).run()
    assert (tmp_path / "one" / "run.json").read_bytes() == (tmp_path / "two" / "run.json").read_bytes()
    timings = RunDirectory(tmp_path / "one").read_timings()
    assert set(timings["stages"]) == set(NAMES) and "cores" in timings["machine"]


def test_listener_tells_in_blocks_and_keeps_every_scalar(tmp_path: Path) -> None:
    reports: list[Progress] = []
    listener = ProgressListener("geometry", PluginManager(), reports.append)
    for step in range(1, 1001):
        listener.report(Progress("", step, 1000, step * 1e-4, {"loss": np.array([1 / step])}))
    listener.close(0.1)
    assert len(reports) < 10, "1000 steps in far less than a second are at most four blocks a second, first and last"
    assert reports[-1].step == 1000 and reports[0].stage == "geometry"
    assert sum(len(p.scalars.get("loss", ())) for p in reports) == 1000
    listener.write(tmp_path / "curves.npz")
    steps, values = read_curves(tmp_path / "curves.npz")["loss"]
    np.testing.assert_array_equal(steps, np.arange(1, 1001))
    np.testing.assert_allclose(values, 1 / np.arange(1, 1001))


def test_a_second_phase_of_a_stage_has_its_own_time_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """800 steps of outlines took ten minutes; the third of 300 steps with photographs does not mean a day."""
    clock = iter([0.0, 600.0, 610.0])
    monkeypatch.setattr("hir_core.run.progress_listener.time.perf_counter", lambda: now[0])
    now = [next(clock)]
    reports: list[Progress] = []
    listener = ProgressListener("geometry", PluginManager(), reports.append)
    now[0] = next(clock)
    listener.report(Progress("geometry", 800, 800, 600.0))
    now[0] = next(clock)
    listener.report(Progress("geometry", 100, 300, 10.0))
    listener.close(610.0)
    assert reports[-1].seconds == 610.0 and listener._last is not None
    assert Progress("x", 100, 300, 610.0, phase_seconds=10.0).seconds_left == pytest.approx(20.0)
    assert reports[-1].phase_seconds == pytest.approx(10.0)


def test_the_preparation_of_a_stage_does_not_count_as_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """The chair's first step of 400 came after 24 s of preparation; that does not mean hours."""
    now = [0.0]
    monkeypatch.setattr("hir_core.run.progress_listener.time.perf_counter", lambda: now[0])
    reports: list[Progress] = []
    listener = ProgressListener("geometry", PluginManager(), reports.append)
    now[0] = 24.0
    listener.report(Progress("geometry", 40, 400, 10.0))
    assert reports[-1].seconds == 24.0 and reports[-1].seconds_left == pytest.approx(90.0)


def test_too_few_steps_tell_no_time_left() -> None:
    assert Progress("x", 0, 1000, 5.0).seconds_left == 0.0
    assert Progress("x", 19, 1000, 5.0).seconds_left == 0.0
    assert Progress("x", 20, 1000, 5.0).seconds_left == pytest.approx(245.0)
    assert Progress("x", 1, 4, 5.0).seconds_left == pytest.approx(15.0)


def result_of(folder: Path, stage: str) -> Path:
    return RunDirectory(folder).stage(stage) / "result"


def test_a_changed_file_of_a_finished_stage_is_named_and_the_stage_computed_again(tmp_path: Path) -> None:
    Chain(tmp_path).run()
    result_of(tmp_path, "geometry").write_text("iX")
    again = Chain(tmp_path)
    assert again.run() == "iga"
    assert again.computed == ["geometry"], "the same files again, so the stages after it hold"
    assert [m for m in again.messages if "geometry: its stored result is damaged" in m and "result has changed" in m]
    assert result_of(tmp_path, "geometry").read_text() == "ig"


def test_a_missing_and_an_added_file_are_noticed(tmp_path: Path) -> None:
    Chain(tmp_path).run()
    result_of(tmp_path, "initializer").unlink()
    (RunDirectory(tmp_path).stage("atlas") / "scene").mkdir()
    added = RunDirectory(tmp_path).stage("atlas") / "scene" / "material.normal.exr"
    added.write_bytes(b"read where it exists")
    again = Chain(tmp_path)
    assert again.run() == "iga" and again.computed == ["initializer", "atlas"] and not added.exists()
    assert any(f"{result_of(tmp_path, 'initializer')} is missing" in m for m in again.messages)
    assert any(f"{added} was not written by it" in m for m in again.messages)


def test_a_stage_that_gives_other_files_than_before_invalidates_those_after_it(tmp_path: Path) -> None:
    class Noisy(Chain):
        def _stage(self, name: str, settings: dict[str, Any], fail: str) -> Stage[str, str]:
            stage = super()._stage(name, settings, fail)
            if name != "geometry":
                return stage
            other = StageResult("iG", WordReport(2))
            return replace(stage, compute=lambda text, context: (self.computed.append(name), other)[1])

    Chain(tmp_path).run()
    result_of(tmp_path, "geometry").unlink()
    noisy = Noisy(tmp_path)
    assert noisy.run() == "iGa" and noisy.computed == ["geometry", "atlas"]


def test_a_changed_record_of_a_stage_is_named(tmp_path: Path) -> None:
    Chain(tmp_path).run()
    path = RunDirectory(tmp_path).stage("geometry") / "stage.json"
    path.write_text(path.read_text().replace('"length": 2', '"length": 3'))
    again = Chain(tmp_path)
    assert again.run() == "iga" and again.computed == ["geometry"]
    assert f"geometry: computed again, because {path} is damaged" in again.messages


def test_the_same_result_is_read_without_the_hidden_files_of_a_file_manager(tmp_path: Path) -> None:
    Chain(tmp_path).run()
    (RunDirectory(tmp_path).stage("geometry") / ".DS_Store").write_bytes(b"icons")
    again = Chain(tmp_path)
    assert again.run() == "iga" and again.computed == []
