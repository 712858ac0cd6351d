"""One group of one capture, on whichever node it is: stage the input, resume the run, keep what was made."""

from __future__ import annotations

import os
import platform
import sys
import time
import traceback
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from hir_core import __version__
from hir_core.errors import HirError, InputError, MissingExtraError
from hir_core.plugins.progress import Progress
from hir_core.run.run_directory import RunDirectory
from hir_plugins.commands.batch.retries import StoreError, is_infrastructure, one_line
from hir_plugins.commands.batch.scheduling.messages import Job, Outcome, Told
from hir_plugins.commands.batch.stage_groups import GROUPS
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.content_hash import work_mark
from hir_plugins.commands.batch.storage.layout import Destination
from hir_plugins.commands.batch.storage.lease import owner_of
from hir_plugins.commands.batch.storage.object_store import Place
from hir_plugins.commands.batch.storage.worker_scratch import Desk, default_cache, desk
from hir_plugins.commands.batch.summary.run_summary import summarize


def run_group(job: Job, tell: Callable[[Told], None]) -> Outcome:
    """Runs one group; every failure becomes an outcome, so that only the death of a process reaches Ray."""
    worker = Worker(job, tell)
    try:
        return worker.work()
    except Exception as error:
        reason, trace = one_line(error), traceback.format_exc()
        if is_infrastructure(error):
            return worker.ended("trouble", reason, trace)
        if isinstance(error, HirError):
            return worker.ended("failed", reason, trace)
        return worker.ended("failed", f"this is a bug: {type(error).__name__}: {reason}", trace)


class Worker:
    """One task: its seconds, and the lines of its log."""

    def __init__(self, job: Job, tell: Callable[[Told], None]) -> None:
        self.job, self.group = job, GROUPS[job.group]
        self.content = job.content
        self.seconds: dict[str, float] = {}
        self.stored = 0
        self.lines: list[str] = []
        self.reused = False
        self._tell, self._told = tell, 0.0
        self._staged = ""
        self._clock = time.perf_counter()

    def work(self) -> Outcome:
        job = self.job
        if job.version != __version__:
            raise InputError(f"node {platform.node()} has hir {__version__}, the batch {job.version}; install the same")
        self._report(Progress(self.group.stages[0], 0, 0, 0.0))
        limit_threads(job.threads)
        destination = Destination(Place(job.destination))
        with desk(Path(job.cache) if job.cache else default_cache(), job.destination, job.name) as place:
            capture, self.content = place.stage(Place(job.source), job.content)
            self._staged = str(capture)
            if job.finished == (self.content, job.settings) and object_store.exists(
                destination.result(job.name) / "run.json"
            ):
                return self.ended("unchanged")
            mark = work_mark(self.content, job.settings)
            place.begin(mark)
            stored = self._restore(destination, mark, place)
            self._lap("stage")
            self._reconstruct(capture, place.run)
            self._lap("compute")
            if owner_of(destination.lease) != job.owner:
                raise StoreError("another batch has taken this destination over")
            if self.group is not GROUPS[-1]:
                for group in GROUPS[: job.group + 1]:
                    if group.name not in stored:
                        self.stored += destination.store_group(job.name, mark, group, place.run)
                self._lap("store")
                return self.ended("done")
            record = self._publish(destination, place)
            self._lap("store")
            return self.ended("done", record=record)

    def ended(self, state: Any, reason: str = "", trace: str = "", record: dict[str, Any] | None = None) -> Outcome:
        """The outcome, with all that was measured and said on the way."""
        self.lines += [reason, *trace.splitlines()] if reason else []
        where = f"{platform.node()} {os.getpid()} {self.group.name}"
        if self._staged:  # the user knows the capture's own address, and the staged copy goes
            reason = reason.replace(self._staged, self.job.source)
            self.lines = [line.replace(self._staged, self.job.source) for line in self.lines]
        lines = tuple(f"[{where}] {line}" for line in self.lines)
        seconds = {name: round(value, 3) for name, value in self.seconds.items()}
        return Outcome(
            state,
            reason,
            self.content,
            platform.node(),
            os.getpid(),
            seconds,
            self.stored,
            lines,
            self.reused,
            record or {},
        )

    def _restore(self, destination: Destination, mark: str, place: Desk) -> set[str]:
        """Fetches what earlier groups made and this node has not; names of the groups that the store keeps."""
        directory = RunDirectory(place.run)
        kept: set[str] = set()
        for group in destination.stored_groups(self.job.name, mark):
            records = [directory.record(stage) for stage in group.stages]
            if not all(record is not None and record.finished for record in records):
                try:
                    destination.fetch_group(self.job.name, mark, group, place.run)
                except InputError as error:
                    self._say(one_line(error))
                    break
            kept.add(group.name)
        return kept

    def _reconstruct(self, capture: Path, run: Path) -> None:
        from hir_core.pipeline import reconstruct
        from hir_core.plugins.manager import PluginManager

        config = self.job.config
        result = reconstruct(
            capture,
            run,
            config=config,
            resume=True,
            until=self.group.until,
            plugins=PluginManager.discover(tuple(config.plugins)),
            on_progress=self._report,
            on_message=self._say,
        )
        self.reused = set(self.group.stages) <= set(result.reused)

    def _publish(self, destination: Destination, place: Desk) -> dict[str, Any]:
        """Result, then record, then the end of what was kept for others: a batch that dies between finds its way."""
        job, directory = self.job, RunDirectory(place.run)
        record = summarize(directory) | {
            "name": job.name,
            "source": job.source,
            "listing": job.listing,
            "content": self.content,
            "settings": job.settings,
        }
        if Place(job.source).local is None:
            document = directory.read_run()
            document["capture"]["path"] = job.source  # the staged copy goes
            directory.write_run(document)
        self.stored = destination.publish(job.name, place.run, job.keep_stages)
        destination.write_record(job.name, record | {"bytes": self.stored})
        object_store.remove(destination.unfinished(job.name))
        place.clear()
        return record | {"bytes": self.stored}

    def _report(self, progress: Progress) -> None:
        now = time.monotonic()
        if now - self._told >= self.job.tell_seconds or progress.step >= progress.steps:
            self._told = now
            job = self.job
            self._tell(
                Told(
                    job.name,
                    job.group,
                    job.attempt,
                    platform.node(),
                    os.getpid(),
                    progress.stage,
                    progress.step,
                    progress.steps,
                    progress.seconds_left,
                )
            )

    def _say(self, sentence: str) -> None:
        self.lines.append(sentence)

    def _lap(self, name: str) -> None:
        now = time.perf_counter()
        self.seconds[name], self._clock = now - self._clock, now


def limit_threads(count: int) -> None:
    """As many threads as the task asked cores for: workers of other captures have the rest of the node."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"):
        if "torch" not in sys.modules:  # read once, when libraries are loaded
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
