"""Runs one task on a node: fetches the input, resumes the run, stores the result."""

from __future__ import annotations

import os
import platform
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol

from hir_core import __version__
from hir_core.config import RunConfig
from hir_core.errors import HirError, InputError, MissingExtraError
from hir_core.plugins.progress import Progress
from hir_core.run.run_directory import RunDirectory
from hir_plugins.commands.batch.retries import StoreError, is_infrastructure_error, one_line
from hir_plugins.commands.batch.scheduling.messages import OutcomeState, ProgressMessage, TaskOutcome, TaskSpec
from hir_plugins.commands.batch.stage_groups import STAGE_GROUPS, StageGroup
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.content_hash import result_key
from hir_plugins.commands.batch.storage.layout import Destination
from hir_plugins.commands.batch.storage.lease import lease_owner
from hir_plugins.commands.batch.storage.storage_path import StoragePath
from hir_plugins.commands.batch.storage.worker_scratch import WorkerScratch, default_cache, worker_scratch
from hir_plugins.commands.batch.summary.run_summary import summarize_run


class RunFunction(Protocol):
    """Runs the stages of a group in a run directory; returns the names of the stages that were reused."""

    def __call__(
        self,
        config: RunConfig,
        capture: Path,
        run: Path,
        group: StageGroup,
        on_progress: Callable[[Progress], None],
        on_message: Callable[[str], None],
    ) -> Sequence[str]: ...


def run_stages(
    config: RunConfig,
    capture: Path,
    run: Path,
    group: StageGroup,
    on_progress: Callable[[Progress], None],
    on_message: Callable[[str], None],
) -> Sequence[str]:
    """Resumes the run until the last stage of the group."""
    from hir_core.pipeline import reconstruct
    from hir_core.plugins.manager import PluginManager

    result = reconstruct(
        capture,
        run,
        config=config,
        resume=True,
        until=group.last_stage,
        plugins=PluginManager.discover(tuple(config.plugins)),
        on_progress=on_progress,
        on_message=on_message,
    )
    return result.reused


def run_task(
    spec: TaskSpec, on_progress: Callable[[ProgressMessage], None], run_function: RunFunction = run_stages
) -> TaskOutcome:
    """Runs one task. Every exception becomes an outcome: Ray only notices if the process itself dies."""
    worker = Worker(spec, on_progress, run_function)
    try:
        return worker.run()
    except Exception as error:
        reason, trace = one_line(error), traceback.format_exc()
        if is_infrastructure_error(error):
            return worker.outcome("infrastructure_error", reason, trace)
        if isinstance(error, HirError):
            return worker.outcome("failed", reason, trace)
        return worker.outcome("failed", f"this is a bug: {type(error).__name__}: {reason}", trace)


class Worker:
    """One task, its timings and its log."""

    def __init__(
        self, spec: TaskSpec, on_progress: Callable[[ProgressMessage], None], run_function: RunFunction
    ) -> None:
        self._run_stages = run_function
        self.spec, self.group = spec, STAGE_GROUPS[spec.group]
        self.content_hash = spec.content_hash
        self.seconds: dict[str, float] = {}
        self.bytes_stored = 0
        self.log_lines: list[str] = []
        self.reused = False
        self._on_progress, self._last_progress = on_progress, 0.0
        self._staged_path = ""
        self._phase_start = time.perf_counter()

    def run(self) -> TaskOutcome:
        """Runs the stages of the group and stores them; publishes the result after the last group."""
        spec = self.spec
        if spec.version != __version__:
            raise InputError(
                f"node {platform.node()} has hir {__version__}, but the batch was started with {spec.version}; "
                "install the same version"
            )
        self._report(Progress(self.group.stages[0], 0, 0, 0.0))
        limit_threads(spec.threads)
        destination = Destination(StoragePath(spec.destination))
        cache = Path(spec.cache) if spec.cache else default_cache()
        with worker_scratch(cache, spec.destination, spec.name) as scratch:
            capture, self.content_hash = scratch.stage_capture(StoragePath(spec.source), spec.content_hash)
            self._staged_path = str(capture)
            if spec.published == (self.content_hash, spec.settings_hash) and object_store.exists(
                destination.result(spec.name) / "run.json"
            ):
                return self.outcome("unchanged")
            key = result_key(self.content_hash, spec.settings_hash)
            scratch.prepare_run(key)
            stored = self._restore(destination, key, scratch)
            self._end_phase("stage")
            reused = self._run_stages(spec.config, capture, scratch.run, self.group, self._report, self._log)
            self.reused = set(self.group.stages) <= set(reused)
            self._end_phase("compute")
            if lease_owner(destination.lease) != spec.lease_token:
                raise StoreError("another batch has acquired the lease of this destination")
            if self.group is not STAGE_GROUPS[-1]:
                for group in STAGE_GROUPS[: spec.group + 1]:
                    if group.name not in stored:
                        self.bytes_stored += destination.store_group(spec.name, key, group, scratch.run)
                self._end_phase("store")
                return self.outcome("done")
            record = self._publish(destination, scratch)
            self._end_phase("store")
            return self.outcome("done", record=record)

    def outcome(
        self, state: OutcomeState, reason: str = "", trace: str = "", record: dict[str, Any] | None = None
    ) -> TaskOutcome:
        """The outcome with the timings and log lines so far."""
        self.log_lines += [reason, *trace.splitlines()] if reason else []
        if self._staged_path:  # the user knows the capture's own address; the staged copy will be removed
            reason = reason.replace(self._staged_path, self.spec.source)
            self.log_lines = [line.replace(self._staged_path, self.spec.source) for line in self.log_lines]
        prefix = f"[{platform.node()} {os.getpid()} {self.group.name}]"
        return TaskOutcome(
            state=state,
            reason=reason,
            content_hash=self.content_hash,
            node=platform.node(),
            pid=os.getpid(),
            seconds={name: round(value, 3) for name, value in self.seconds.items()},
            bytes_stored=self.bytes_stored,
            log_lines=tuple(f"{prefix} {line}" for line in self.log_lines),
            reused=self.reused,
            record=record or {},
        )

    def _restore(self, destination: Destination, key: str, scratch: WorkerScratch) -> set[str]:
        """Fetches the stages of earlier tasks that this node lacks; returns the names of the groups in the store."""
        directory = RunDirectory(scratch.run)
        stored: set[str] = set()
        for group in destination.stored_groups(self.spec.name, key):
            records = [directory.record(stage) for stage in group.stages]
            if not all(record is not None and record.finished for record in records):
                try:
                    destination.fetch_group(self.spec.name, key, group, scratch.run)
                except InputError as error:
                    self._log(one_line(error))
                    break
            stored.add(group.name)
        return stored

    def _publish(self, destination: Destination, scratch: WorkerScratch) -> dict[str, Any]:
        """Publishes the result, then its record, then removes the stored stages: a batch that dies in between can
        continue.
        """
        spec, directory = self.spec, RunDirectory(scratch.run)
        record = summarize_run(directory).document() | {
            "name": spec.name,
            "source": spec.source,
            "listing_hash": spec.listing_hash,
            "content_hash": self.content_hash,
            "settings_hash": spec.settings_hash,
        }
        if StoragePath(spec.source).local is None:
            document = directory.read_run()
            document["capture"]["path"] = spec.source  # the staged copy will be removed
            directory.write_run(document)
        self.bytes_stored = destination.publish(spec.name, scratch.run, spec.keep_stages)
        record["bytes"] = self.bytes_stored
        destination.write_record(spec.name, record)
        object_store.remove(destination.unfinished(spec.name))
        scratch.clear()
        return record

    def _report(self, progress: Progress) -> None:
        now = time.monotonic()
        if now - self._last_progress < self.spec.progress_interval_s and progress.step < progress.steps:
            return
        self._last_progress = now
        self._on_progress(
            ProgressMessage(
                name=self.spec.name,
                group=self.spec.group,
                attempt=self.spec.attempt,
                node=platform.node(),
                pid=os.getpid(),
                stage=progress.stage,
                step=progress.step,
                steps=progress.steps,
                seconds_left=progress.seconds_left,
            )
        )

    def _log(self, message: str) -> None:
        self.log_lines.append(message)

    def _end_phase(self, name: str) -> None:
        now = time.perf_counter()
        self.seconds[name], self._phase_start = now - self._phase_start, now


def limit_threads(count: int) -> None:
    """Limits this process to the cores that the task requested; other tasks use the rest of the node.

    Raises `MissingExtraError` if the node lacks the packages for reconstruction.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"):
        if "torch" not in sys.modules:  # read once, when the libraries are loaded
            os.environ[name] = str(count)
    missing = [name for name in ("torch", "jaxtyping") if find_spec(name) is None]
    if missing:
        raise MissingExtraError(
            f"node {platform.node()} lacks {', '.join(missing)}; install on every node: "
            "pip install 'hir[reconstruct,batch]'"
        )
    import torch

    torch.set_num_threads(count)
    if find_spec("drjit") is not None:
        import drjit

        drjit.set_thread_count(count)
