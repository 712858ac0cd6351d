"""Runs one stage: reuses its stored result where nothing it depends on changed, else computes, stores and times it."""

from __future__ import annotations

import contextlib
import hashlib
import json
import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, is_dataclass, replace
from pathlib import Path
from typing import Any, Final

from hir_core.errors import HirError, InputError
from hir_core.files.json_documents import jsonable, read_json, write_json
from hir_core.plugins.manager import PluginManager
from hir_core.plugins.progress import Progress, Throttle
from hir_core.run.determinism import seed_everything
from hir_core.run.machine import peak_memory_bytes, processor_seconds, return_freed_memory
from hir_core.run.progress_listener import ProgressListener
from hir_core.run.run_directory import LAST_STAGE, RECORD, RunDirectory, StageRecord
from hir_core.run.run_records import RunRecords, current_time
from hir_core.run.stage import Stage, State, Value
from hir_core.run.stage_context import StageContext

_SPENT: Final = "seconds.json"
_STORE_INTERVAL_S: Final = 10.0


@dataclass
class StageRunner:
    """Runs the stages of one call of `reconstruct`, in order; the cache key of each covers all before it."""

    plugins: PluginManager
    directory: RunDirectory
    records: RunRecords
    context: StageContext
    """For every stage: device, seed, options of renderers; the runner adds workspace, progress and warnings."""
    expected_memory: Mapping[str, str]
    """What is said about the memory of a stage before it starts, by stage; empty without a limit."""
    on_progress: Callable[[Progress], None] | None
    on_message: Callable[[str], None]
    key: str
    """Hash of all that the next stage's input depends on: settings, and the files of the stages before it."""
    reused: list[str] = field(default_factory=list)
    """Stages whose stored result was used."""

    def run(self, stage: Stage[State, Value], state: State) -> State:
        """The state with the stage's value."""
        settings = stage.settings(state)
        self.key = cache_key(self.key, stage.name, settings, self.context.seed, self.context.deterministic)
        record = self.directory.record(stage.name)
        stored = self._stored(stage, state, record)
        timings = None
        if stored is not None and record is not None:
            (value,) = stored
            self.reused.append(stage.name)
            self.on_message(f"{stage.name}: reused, its settings and input are unchanged")
        else:
            value, record, timings = self._compute(stage, state)
            if stage.name != LAST_STAGE:
                self.records.forget_metrics()
        self.key = cache_key(self.key, record.files)
        state = stage.extend(state, value)
        if timings is not None:
            scene = stage.scene(state)
            self.plugins.notify("hir_stage_finished", stage=stage.name, scene=scene, report=record.report)
        self.records.add_stage(record, timings)
        return state

    def _stored(self, stage: Stage[State, Value], state: State, record: StageRecord | None) -> tuple[Value] | None:
        """The stored value of a finished stage of the same key, in a tuple; None where there is none."""
        if record is None:
            path = self.directory.stage(stage.name) / RECORD
            if path.exists():
                self.on_message(f"{stage.name}: computed again, because {path} is damaged")
            return None
        if not record.finished or record.key != self.key:
            self.on_message(
                f"{stage.name}: computed again, because its settings or input changed or it was interrupted"
            )
            return None
        damage = self.directory.damage(record)
        if damage is not None:
            self.on_message(f"{stage.name}: its stored result is damaged ({damage}); it is computed again")
            return None
        try:
            return (stage.load(state, self.directory.stage(stage.name)),)
        except InputError as error:
            self.on_message(f"{stage.name}: its stored result is damaged ({error}); it is computed again")
            return None

    def _compute(self, stage: Stage[State, Value], state: State) -> tuple[Value, StageRecord, dict[str, Any]]:
        name = stage.name
        if name in self.expected_memory:
            self.on_message(f"{name}: {self.expected_memory[name]}")
        listener = ProgressListener(name, self.plugins, self.on_progress)
        warnings: list[str] = []
        context = self._context(name, self.directory.begin(name, self.key), listener, warnings)
        seed_everything(self.context.seed)
        clock = _StageClock(context.workspace / _SPENT)
        context = replace(context, report=clock.after(context.report))
        try:
            with listener.heartbeat():
                result = stage.compute(state, context)
        except BaseException:
            clock.store()
            raise
        (seconds, cpu_seconds), earlier = clock.spent(), clock.earlier[0]
        listener.close(seconds - earlier)
        folder = self.directory.stage(name)
        stage.save(state, result.value, folder)
        listener.write(folder / "curves.npz")
        files = self.directory.checksums(name, stage.folders)
        record = StageRecord(name, self.key, True, result.report_document(), tuple(warnings), files)
        self.directory.finish(record)
        shutil.rmtree(context.checkpoints, ignore_errors=True)
        (context.workspace / _SPENT).unlink(missing_ok=True)
        return_freed_memory()
        before = f", {earlier:.1f} s of them before it was interrupted" if earlier else ""
        self.on_message(f"{name}: {seconds:.1f} s{before}")
        timings = {
            "seconds": round(seconds, 3),
            "processor_seconds": round(cpu_seconds, 3),
            "peak_memory_bytes": peak_memory_bytes(),
            "finished": current_time(),
            "progress": [(step, round(earlier + reached, 3)) for step, reached in listener.seconds],
            "milestones": [(text, round(earlier + reached, 3)) for text, reached in listener.milestones],
        }
        if context.part_seconds:
            timings["part_seconds"] = {part: round(spent, 3) for part, spent in context.part_seconds.items()}
        return stage.load(state, folder) if stage.reads_back else result.value, record, timings

    def _context(self, name: str, workspace: Path, listener: ProgressListener, warnings: list[str]) -> StageContext:
        def warn(sentence: str) -> None:
            if sentence not in warnings:
                warnings.append(sentence)
                self.on_message(f"{name}: warning: {sentence}")

        return replace(self.context, workspace=workspace, part_seconds={}, report=listener.report, warn=warn)


class _StageClock:
    """Wall-clock and processor seconds of a stage, those of earlier calls that were interrupted in it included.

    They are stored every `_STORE_INTERVAL_S`, as a call may end without a word.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._started, self._processor_started = time.perf_counter(), processor_seconds()
        self._throttle = Throttle(_STORE_INTERVAL_S)
        self.earlier = _stored_seconds(path)
        """Of earlier calls."""

    def spent(self) -> tuple[float, float]:
        """Of all calls."""
        seconds, cpu_seconds = time.perf_counter() - self._started, processor_seconds() - self._processor_started
        return self.earlier[0] + seconds, self.earlier[1] + cpu_seconds

    def after(self, report: Callable[[Progress], None]) -> Callable[[Progress], None]:
        """`report`, and then the times are stored where the last ones are old."""

        def report_and_store(progress: Progress) -> None:
            report(progress)
            if self._throttle.ready:
                self._throttle.restart()
                self.store()

        return report_and_store

    def store(self) -> None:
        """Writes the times; a full disk is found by what needs its files."""
        seconds, cpu_seconds = self.spent()
        with contextlib.suppress(OSError, HirError):
            write_json(self._path, {"seconds": round(seconds, 3), "processor_seconds": round(cpu_seconds, 3)})


def _stored_seconds(path: Path) -> tuple[float, float]:
    """What `_StageClock` stored; zeros where there is nothing, or what is there is damaged."""
    try:
        document = read_json(path)
        seconds, cpu_seconds = float(document["seconds"]), float(document["processor_seconds"])
    except (InputError, KeyError, TypeError, ValueError):
        return 0.0, 0.0
    return (seconds, cpu_seconds) if 0 <= min(seconds, cpu_seconds) <= max(seconds, cpu_seconds) < 1e9 else (0.0, 0.0)


def cache_key(*parts: Any) -> str:
    """Hash of JSON-compatible values and dataclasses."""
    plain = [asdict(p) if is_dataclass(p) and not isinstance(p, type) else p for p in parts]
    text = json.dumps(jsonable(plain), sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()
