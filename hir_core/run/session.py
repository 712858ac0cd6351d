"""The machinery around the stages of a run: what is reused, who listens, what is written and timed."""

from __future__ import annotations

import hashlib
import json
import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, is_dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

from hir_core.config import RunConfig
from hir_core.errors import ConfigError, InputError
from hir_core.files.json_documents import jsonable
from hir_core.plugins.manager import PluginManager
from hir_core.run.determinism import seed_everything
from hir_core.run.machine import describe_machine, peak_memory_bytes, processor_seconds, return_freed_memory, versions
from hir_core.run.memory_plan import Plan, gigabytes
from hir_core.run.progress_listener import Listener
from hir_core.run.run_directory import STAGES, RunDirectory, StageRecord
from hir_core.run.run_log import write_log
from hir_core.run.stage_context import StageContext

Value = TypeVar("Value")
Report = Mapping[str, Any]


class StopRun(Exception):  # noqa: N818 - the outcome of a check, not a failure of the program
    """The last stage that was asked for is done."""


@dataclass
class Session:
    """One call of `reconstruct`: settings, plugins, folder and listeners, and the records that grow stage by stage."""

    config: RunConfig
    plugins: PluginManager
    directory: RunDirectory
    device: str
    until: str = "export"
    on_progress: Callable[[Any], None] | None = None
    on_message: Callable[[str], None] | None = None
    key: str = ""
    """Hash of all that the next stage's input depends on."""
    reused: list[str] = field(default_factory=list)
    document: dict[str, Any] = field(default_factory=dict)
    """run.json so far."""
    timings: dict[str, Any] = field(default_factory=dict)
    """timings.json so far."""
    memory: Plan | None = None
    """What each stage is expected to take."""

    def allow(self, plan: Plan) -> None:
        """Takes the settings of a plan and says what is different in them."""
        self.config, self.memory = plan.config, plan
        for change in plan.changes:
            self._say(f"to stay within {gigabytes(plan.limit)} of memory: {change}")

    def start(self, capture: Mapping[str, Any]) -> None:
        """Writes run.json and timings.json as they are before the first stage, and tells the observers."""
        self.document = {
            "capture": dict(capture),
            "settings": asdict(self.config),
            "seed": self.config.seed,
            "versions": versions(),
            "plugins": [
                f"{r.kind} {r.component.name} ({r.distribution} {r.version})".strip() for r in self.plugins.components()
            ],
            "plugin_problems": list(self.plugins.problems),
            "stages": {},
            "metrics": self._old_metrics(),
        }
        if self.memory is not None and self.memory.limit:
            self.document["memory"] = self.memory.document()
        old = self.directory.read_timings()
        self.timings = {"machine": describe_machine(self.device), "started": _now(), "stages": old.get("stages", {})}
        self._write()
        self.plugins.notify("hir_run_started", config=self.config, run_folder=self.directory.path)

    def stage(
        self,
        name: str,
        settings: Any,
        compute: Callable[[StageContext], tuple[Value, Report]],
        save: Callable[[Value, Path], None],
        load: Callable[[Path], Value],
        scene_of: Callable[[Value], Any] = lambda value: value,
    ) -> Value:
        """The result of a stage: read where a finished one of the same settings and input exists, else computed.

        After the stage that `--until` names it raises `StopRun`: what belongs to that stage has been recorded by then.
        """
        if self.until in self.document["stages"]:
            raise StopRun
        self.key = _hash(self.key, name, settings, self.config.seed, self.config.deterministic)
        record = self.directory.record(name)
        found = self._stored(name, record, load)
        if found is not None and record is not None:
            (value,) = found
            self.reused.append(name)
            self._say(f"{name}: reused, its settings and input are unchanged")
        else:
            value, record = self._run(name, compute, save)
            if name != "export":
                self.document["metrics"] = {}  # they are of another asset
            self.plugins.notify("hir_stage_finished", stage=name, scene=scene_of(value), report=record.report)
        self.document["stages"][name] = {"report": record.report, "warnings": record.warnings}
        self._write()
        return value

    def finish(self) -> None:
        """Dates the end of the run."""
        self.timings["finished"] = _now()
        self.timings["seconds"] = sum(s.get("seconds", 0.0) for s in self.timings["stages"].values())
        self._write()

    def _stored(self, name: str, record: StageRecord | None, load: Callable[[Path], Value]) -> tuple[Value] | None:
        """The result of a finished stage of the same settings and input, in a tuple; None where there is none."""
        if record is None or not record.finished or record.key != self.key:
            return None
        try:
            return (load(self.directory.stage(name)),)
        except InputError as error:
            self._say(f"{name}: its stored result is damaged ({error})")
            return None

    def _run(
        self, name: str, compute: Callable[[StageContext], tuple[Value, Report]], save: Callable[[Value, Path], None]
    ) -> tuple[Value, StageRecord]:
        if self.directory.record(name) is not None:
            self._say(f"{name}: done again, its settings or input changed or it was interrupted")
        if self.memory is not None and self.memory.limit and self.memory.total(name):
            self._say(f"{name}: about {gigabytes(self.memory.total(name))} of memory expected")
        workspace = self.directory.begin(name, self.key)
        warnings: list[str] = []

        def warn(sentence: str) -> None:
            if sentence not in warnings:
                warnings.append(sentence)
                self._say(f"{name}: warning: {sentence}")

        listener = Listener(name, self.plugins, self.on_progress)
        context = StageContext(
            plugins=self.plugins,
            workspace=workspace,
            options={
                "geometry_renderer": self.config.geometry_renderer,
                "reflectance_renderer": self.config.reflectance_renderer,
            },
            device=self.device,
            seed=self.config.seed,
            deterministic=self.config.deterministic,
            checkpoint_seconds=self.config.checkpoint_seconds,
            report=listener.report,
            warn=warn,
        )
        seed_everything(self.config.seed)
        started, worked = time.perf_counter(), processor_seconds()
        with listener.beating():
            value, report = compute(context)
        seconds, worked = time.perf_counter() - started, processor_seconds() - worked
        listener.close(seconds)
        folder = self.directory.stage(name)
        save(value, folder)
        listener.write(folder / "curves.npz")
        record = StageRecord(name, self.key, True, jsonable(report), tuple(warnings))
        self.directory.finish(record)
        shutil.rmtree(context.checkpoints, ignore_errors=True)
        return_freed_memory()
        self.timings["stages"][name] = {
            "seconds": round(seconds, 3),
            "processor_seconds": round(worked, 3),
            "peak_memory_bytes": peak_memory_bytes(),
            "finished": _now(),
            "progress": listener.seconds,
            "milestones": listener.milestones,
        }
        self._say(f"{name}: {seconds:.1f} s")
        return value, record

    def _old_metrics(self) -> dict[str, Any]:
        """What `hir evaluate` found of an earlier result, which holds until a stage is computed again."""
        if not (self.directory.path / "run.json").exists():
            return {}
        try:
            return dict(self.directory.read_run().get("metrics", {}))
        except (InputError, TypeError, ValueError):
            return {}

    def _write(self) -> None:
        for problem in self.plugins.problems[len(self.document["plugin_problems"]) :]:
            self._say(f"plugin problem: {problem}")
        self.document["plugin_problems"] = list(self.plugins.problems)
        self.directory.write_run(self.document)
        self.directory.write_timings(self.timings)

    def _say(self, sentence: str) -> None:
        write_log(self.directory.log, sentence)
        if self.on_message is not None:
            self.on_message(sentence)


def resolve_device(device: str) -> str:
    """`cpu` or `cuda`: what `auto` means here; an error where CUDA is asked for and there is none."""
    import torch

    if device not in ("auto", "cpu", "cuda"):
        raise ConfigError(f"device {device!r} is not known; it is auto, cpu or cuda")
    if device == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    if device == "cuda" and not torch.cuda.is_available():
        raise ConfigError("device cuda: torch sees no CUDA device; use --device cpu (`hir doctor` says what is found)")
    return device


def check_until(until: str | None) -> str:
    """A stage's name, the last one by default."""
    if until is None:
        return STAGES[-1]
    if until not in STAGES:
        raise ConfigError(f"there is no stage {until!r}; the stages are: {', '.join(STAGES)}")
    return until


def _hash(*parts: Any) -> str:
    plain = [asdict(p) if is_dataclass(p) and not isinstance(p, type) else p for p in parts]
    text = json.dumps(jsonable(plain), sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
