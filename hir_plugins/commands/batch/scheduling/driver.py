"""The driver of a batch: submits tasks to Ray, handles their outcomes, writes the manifest and the summary page."""

from __future__ import annotations

import random
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final

from hir_core import __version__
from hir_core.errors import ConfigError, StageError
from hir_plugins.commands.batch.batch_options import BatchOptions
from hir_plugins.commands.batch.cluster_capacity import max_captures_in_progress, unsatisfiable_request
from hir_plugins.commands.batch.retries import RetryPolicy, StoreError
from hir_plugins.commands.batch.scheduling.capture_arguments import capture_jobs
from hir_plugins.commands.batch.scheduling.capture_job import CaptureJob, JobState
from hir_plugins.commands.batch.scheduling.capture_status import CaptureStatus, StatusChecker
from hir_plugins.commands.batch.scheduling.events import BatchEvent, RunningTask
from hir_plugins.commands.batch.scheduling.manifest import Manifest, current_time
from hir_plugins.commands.batch.scheduling.messages import ProgressMessage, TaskOutcome, TaskSpec
from hir_plugins.commands.batch.scheduling.ray_cluster import EndedTask, RayCluster, TaskRef
from hir_plugins.commands.batch.scheduling.time_estimate import TimeEstimate
from hir_plugins.commands.batch.stage_groups import STAGE_GROUPS
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.content_hash import settings_hash
from hir_plugins.commands.batch.storage.layout import Destination
from hir_plugins.commands.batch.storage.lease import Lease
from hir_plugins.commands.batch.storage.storage_path import parse_storage_path
from hir_plugins.commands.batch.summary.summary_page import write_page

NODE_QUERY_INTERVAL_S: Final = 2.0
PAGE_INTERVAL_S: Final = 60.0
TASK_RETRIES: Final = RetryPolicy(attempts=3, initial_wait_s=2.0, factor=4.0)


class Batch:
    """The jobs of a batch; `run` returns when each is done or failed."""

    def __init__(
        self,
        captures: Sequence[str],
        destination: str,
        options: BatchOptions,
        on_event: Callable[[BatchEvent], None] = lambda event: None,
        on_update: Callable[[Batch], None] = lambda batch: None,
    ) -> None:
        self.destination = Destination(parse_storage_path(destination))
        self.jobs = capture_jobs(captures, self.destination)
        self.options, self._on_event, self._on_update = options, on_event, on_update
        if options.config.device == "cuda" and not any(options.requests.of(group).gpus for group in STAGE_GROUPS):
            raise ConfigError("device=cuda: no stage group requests a GPU; request one, or a fraction, with --gpus")
        self.settings_hash = settings_hash(options.config)
        self.running: dict[TaskRef, RunningTask] = {}
        self.state_counts = Counter({"waiting": len(self.jobs)})
        """The number of captures in each state."""
        self._running_by_name: dict[str, RunningTask] = {}
        self.estimate = TimeEstimate()
        self.max_in_progress = 1
        self.usage: dict[str, tuple[float, float]] = {}
        """For CPU and GPU: the amount in use and the total."""
        self._ready: list[CaptureJob] = []
        self._retry_policy = replace(TASK_RETRIES, attempts=options.attempts)
        self._next_node_query = self._next_page = 0.0
        self._unsatisfiable = ""
        header = {
            "settings_hash": self.settings_hash,
            "preset": options.config.preset,
            "hir": __version__,
            "started": current_time(),
        }
        self._manifest = Manifest(self.destination.manifest, header)

    def run(self) -> list[CaptureJob]:
        """Processes all captures. After Ctrl-C the same call continues the batch."""
        with (
            Lease(self.destination.lease, self.message) as self._lease,
            RayCluster(self.options.address, self.message) as cluster,
        ):
            self._cluster = cluster
            entries = self._manifest.read()
            for job in self.jobs:
                job.restore(entries.get(job.name, {}))
            self._status_checker = StatusChecker(
                self.jobs, self.settings_hash, self.destination, entries, self.options.retry_failed
            )
            self._query_nodes()
            if self._unsatisfiable and cluster.started_here:
                raise ConfigError(self._unsatisfiable)
            self.event("batch_started", captures=len(self.jobs), destination=str(self.destination.root))
            try:
                while self._ready or self.running or not self._status_checker.finished:
                    self._update()
            finally:
                self._status_checker.close()
                self._stop()
        self.event("batch_finished", done=self.state_counts["done"], failed=self.state_counts["failed"])
        return self.jobs

    def event(self, name: str, capture: str = "", **details: Any) -> None:
        """Passes an event to the listener."""
        self._on_event(BatchEvent(name, capture, details))

    def message(self, sentence: str) -> None:
        """Passes a sentence for the user to the listener."""
        self.event("message", message=sentence)

    def _update(self) -> None:
        if self._lease.lost:
            raise StageError(f"another batch has acquired the lease of {self.destination.root}; this batch stops")
        has_capacity = len(self._ready) + len(self.running) < self.max_in_progress
        for job, status in self._status_checker.completed(has_capacity):
            self._handle_status(job, status)
        self._submit_tasks()
        seconds = 0.02 if self._status_checker.running else 0.25
        if self.running:
            for ended in self._cluster.wait(list(self.running), seconds):
                self._handle_ended(ended)
        else:
            time.sleep(seconds)
        for message in self._cluster.progress_messages():
            self._handle_progress(message)
        self._query_nodes()
        self._write_summary(final=False)
        self._on_update(self)

    def _handle_status(self, job: CaptureJob, status: CaptureStatus) -> None:
        if status.state == "unreadable":
            job.reason = status.reason
            self._set_state(job, "failed")
            self._report_failure(job)
            return
        if status.record:
            job.set_published(status.record)
        job.listing_hash, job.content_hash = status.listing_hash, status.content_hash
        if status.state == "unfinished":
            job.group, job.settings_hash, job.reason = status.group, self.settings_hash, ""
            self._ready.append(job)
        elif status.state == "finished":
            job.settings_hash, job.reason = self.settings_hash, ""
            self._set_state(job, "done")
            self.event("capture_skipped", job.name, reason="finished by an earlier call")
        else:
            self._set_state(job, "failed")
            self.event("capture_skipped", job.name, reason=f"failed in an earlier call: {job.reason}")

    def _submit_tasks(self) -> None:
        """Captures that have advanced the most go first: results come early, and few unfinished stages are stored."""
        now = time.monotonic()
        due = sorted((job for job in self._ready if job.not_before <= now), key=lambda job: -job.group)
        for job in due[: max(self.max_in_progress - len(self.running), 0)]:
            self._ready.remove(job)
            job.attempt += 1
            self._set_state(job, "running")
            ref = self._cluster.submit(self._task_spec(job), self.options.requests.of(STAGE_GROUPS[job.group]))
            self.running[ref] = self._running_by_name[job.name] = RunningTask(job, now)

    def _task_spec(self, job: CaptureJob) -> TaskSpec:
        options = self.options
        request = options.requests.of(STAGE_GROUPS[job.group])
        config = options.config
        if config.device == "cuda" and request.gpus == 0:
            config = replace(config, device="auto")  # chooses the CPU: a task without a GPU request sees no GPU
        return TaskSpec(
            name=job.name,
            source=job.source,
            destination=self.destination.root.url,
            group=job.group,
            config=config,
            settings_hash=self.settings_hash,
            lease_token=self._lease.token,
            version=__version__,
            threads=request.threads,
            attempt=job.attempt,
            listing_hash=job.listing_hash,
            content_hash=job.content_hash,
            published=job.published,
            cache=str(options.cache or ""),
            keep_stages=options.keep_stages,
            progress_interval_s=max(0.5, self.max_in_progress / 1000),  # limits the messages that one driver receives
        )

    def _handle_ended(self, ended: EndedTask) -> None:
        task = self.running.pop(ended.ref)
        job, group = task.job, task.job.group
        outcome = ended.outcome or TaskOutcome(
            "infrastructure_error", ended.reason, log_lines=(f"[driver] {ended.reason}",)
        )
        now = time.monotonic()
        del self._running_by_name[job.name]
        if task.progress is None and outcome.pid:
            self._report_start(task, outcome.node, outcome.pid)  # it ended before its first message arrived
        before = job.state
        transition = job.apply(outcome, self._retry_policy, now, random.random())
        self._count_state(before, job.state)
        wall = round(now - task.submitted, 3)
        details = {"group": STAGE_GROUPS[group].name, "seconds": wall}
        if outcome.reused:
            self.event("group_reused", job.name, **details)
        elif transition in ("next group", "done"):
            job.seconds[STAGE_GROUPS[group].name]["wall"] = wall
            self.estimate.record(group, sum(outcome.seconds.values()))
            self.event("group_finished", job.name, **details)
        if transition == "done":
            self.event(
                "capture_finished",
                job.name,
                psnr=job.record.get("psnr"),
                retries=job.retries,
                warnings=job.record.get("warnings"),
            )
        elif transition == "unchanged":
            self._update_listing(job)
            self.event("capture_skipped", job.name, reason="finished by an earlier call; only file dates changed")
        elif transition == "failed":
            self._report_failure(job)
        else:
            self._ready.append(job)
        if transition == "retry":
            seconds = round(job.not_before - now, 1)
            self.event("group_failed", job.name, **details, reason=outcome.reason, retry_in_seconds=seconds)

    def _update_listing(self, job: CaptureJob) -> None:
        """Stores the new listing hash, so that the next call does not read the photographs again."""
        try:
            record = self.destination.record(job.name) | {"listing_hash": job.listing_hash}
            self.destination.write_record(job.name, record)
        except StoreError as error:
            self.message(str(error))

    def _report_failure(self, job: CaptureJob) -> None:
        lines = [*job.log_lines, f"[driver] {job.reason}"]
        try:
            object_store.write(self.destination.log(job.name), ("\n".join(lines) + "\n").encode())
        except StoreError as error:
            self.message(str(error))
        self.event("capture_failed", job.name, reason=job.reason, log=str(self.destination.log(job.name)))

    def _handle_progress(self, message: ProgressMessage) -> None:
        task = self._running_by_name.get(message.name)
        if task is None or task.job.attempt != message.attempt:
            return  # from a task that has ended
        if task.progress is None:
            self._report_start(task, message.node, message.pid)
        task.progress = message
        self.event("progress", message.name, stage=message.stage, step=message.step, steps=message.steps)

    def _report_start(self, task: RunningTask, node: str, pid: int) -> None:
        self.event("group_started", task.job.name, group=STAGE_GROUPS[task.job.group].name, node=node, pid=pid)

    def _set_state(self, job: CaptureJob, state: JobState) -> None:
        self._count_state(job.state, state)
        job.state = state

    def _count_state(self, before: str, after: str) -> None:
        self.state_counts[before] -= 1
        self.state_counts[after] += 1

    def _query_nodes(self) -> None:
        now = time.monotonic()
        if now < self._next_node_query:
            return
        self._next_node_query = now + NODE_QUERY_INTERVAL_S
        nodes = self._cluster.nodes()
        self.max_in_progress = self.options.max_in_progress or max_captures_in_progress(nodes, self.options.requests)
        self.usage = self._cluster.usage()
        unsatisfiable = unsatisfiable_request(nodes, self.options.requests)
        if unsatisfiable and not self._unsatisfiable:
            self.message(f"waiting: {unsatisfiable}")
        self._unsatisfiable = unsatisfiable

    def _stop(self) -> None:
        """Cancels the tasks that an interrupt or an error left running, and writes the summary."""
        for ref, task in self.running.items():
            self._cluster.cancel(ref)
            self._set_state(task.job, "waiting")
        self.running.clear()
        self._write_summary(final=True)

    def _write_summary(self, final: bool) -> None:
        try:
            self._manifest.write(self.jobs, force=final)
            if final or time.monotonic() > self._next_page:
                write_page(self.destination, self._manifest.entries(self.jobs), current_time())
                self._next_page = time.monotonic() + PAGE_INTERVAL_S
        except StoreError as error:
            if final:
                raise
            self.message(f"{error}; retrying")
