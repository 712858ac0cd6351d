"""run.json and timings.json while a run grows: run.json is the same for the same run, timings.json is not."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any

from hir_core.errors import InputError
from hir_core.plugins.manager import PluginManager
from hir_core.run.machine import describe_machine, versions
from hir_core.run.run_directory import RunDirectory, StageRecord


class RunRecords:
    """Writes both files before the first stage and after each one."""

    def __init__(self, directory: RunDirectory, plugins: PluginManager, on_message: Callable[[str], None]) -> None:
        self._directory = directory
        self._plugins = plugins
        self._on_message = on_message
        self._document: dict[str, Any] = {}
        self._timings: dict[str, Any] = {}

    def start(
        self, capture: Mapping[str, Any], settings: Mapping[str, Any], memory: Mapping[str, Any], device: str
    ) -> None:
        """Writes both files as they are before the first stage; `memory` is empty where no limit is set."""
        self._document = {
            "capture": dict(capture),
            "settings": dict(settings),
            "seed": settings["seed"],
            "versions": versions(),
            "plugins": [
                f"{r.kind} {r.component.name} ({f'{r.distribution} {r.version}'.strip()})"
                for r in self._plugins.components()
            ],
            "plugin_problems": list(self._plugins.problems),
            "stages": {},
            "metrics": self._earlier_metrics(),
        }
        if memory:
            self._document["memory"] = dict(memory)
        self._timings = {
            "machine": describe_machine(device),
            "started": current_time(),
            "stages": self._earlier_timings(),
        }
        if report := self._earlier_report():
            self._timings["report"] = report
        self._write()

    def add_stage(self, record: StageRecord, timings: Mapping[str, Any] | None) -> None:
        """Adds a finished stage; `timings` is None where its result was reused."""
        self._document["stages"][record.stage] = {"report": record.report, "warnings": record.warnings}
        if timings is not None:
            self._timings["stages"][record.stage] = dict(timings)
        self._write()

    def forget_metrics(self) -> None:
        """Drops what `hir evaluate` measured: it belongs to an earlier result."""
        self._document["metrics"] = {}

    def finish(self) -> None:
        """Writes the time at which the run ended."""
        self._timings["finished"] = current_time()
        self._timings["seconds"] = sum(s.get("seconds", 0.0) for s in self._timings["stages"].values())
        self._write()

    def add_report(self, seconds: float, processor_seconds: float) -> None:
        """Adds the times of a report whose pictures were rendered after `finish`."""
        self._timings["report"] = {"seconds": round(seconds, 3), "processor_seconds": round(processor_seconds, 3)}
        self._write()

    def add_problems(self) -> None:
        """Records the problems of plugins that came up after the latest record, such as in the report."""
        if len(self._plugins.problems) > len(self._document["plugin_problems"]):
            self._write()

    def _earlier_metrics(self) -> dict[str, Any]:
        """What `hir evaluate` measured of an earlier result; it holds until a stage is computed again."""
        if not (self._directory.path / "run.json").exists():
            return {}
        try:
            return dict(self._directory.read_run().get("metrics", {}))
        except (InputError, TypeError, ValueError):
            return {}

    def _earlier_timings(self) -> dict[str, Any]:
        """Times of stages that an earlier call computed; damaged ones are lost, and a message says so."""
        try:
            stages = self._directory.read_timings().get("stages", {})
        except InputError as error:
            self._on_message(f"the times of earlier stages are lost: {error}")
            return {}
        if not isinstance(stages, dict) or not all(isinstance(s, dict) for s in stages.values()):
            self._on_message("the times of earlier stages are lost: timings.json is damaged")
            return {}
        sound = {name: entry for name, entry in stages.items() if _is_complete(entry)}
        if lost := [name for name in stages if name not in sound]:
            self._on_message(f"the times of the stages {', '.join(lost)} are lost: timings.json is damaged")
        return sound

    def _earlier_report(self) -> dict[str, float]:
        """Times of a report that an earlier call wrote; its pictures may still be right."""
        try:
            report = self._directory.read_timings().get("report", {})
        except InputError:
            return {}
        times = ("seconds", "processor_seconds")
        if not isinstance(report, dict) or not all(_is_number(report.get(key)) for key in times):
            return {}
        return {key: report[key] for key in times}

    def _write(self) -> None:
        for problem in self._plugins.problems[len(self._document["plugin_problems"]) :]:
            self._on_message(f"plugin problem: {problem}")
        self._document["plugin_problems"] = list(self._plugins.problems)
        self._directory.write_run(self._document)
        self._directory.write_timings(self._timings)


def current_time() -> str:
    """ISO 8601 in UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def _is_complete(entry: Mapping[str, Any]) -> bool:
    """Whether the times of a stage have all that reports read, as `StageRunner` writes it."""
    milestones = entry.get("milestones")
    return (
        all(_is_number(entry.get(key)) for key in ("seconds", "processor_seconds", "peak_memory_bytes"))
        and isinstance(milestones, list)
        and all(isinstance(each, list) and len(each) == 2 and _is_number(each[1]) for each in milestones)
    )


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)
