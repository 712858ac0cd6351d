"""Decides, before a capture is processed, whether it exists, whether it is finished, and where to continue."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, Final, Literal

from hir_core.errors import HirError
from hir_plugins.commands.batch.scheduling.capture_job import CaptureJob
from hir_plugins.commands.batch.stage_groups import STAGE_GROUPS
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.content_hash import listing_hash, result_key
from hir_plugins.commands.batch.storage.layout import Destination
from hir_plugins.commands.batch.storage.storage_path import StoragePath

MAX_PARALLEL_CHECKS: Final = 32


@dataclass(frozen=True)
class CaptureStatus:
    """The status of a capture at the start of a batch."""

    state: Literal["unfinished", "finished", "failed before", "unreadable"]
    listing_hash: str = ""
    content_hash: str = ""
    """Known if the listing is unchanged since the content was hashed; otherwise empty."""
    group: int = 0
    """Index of the first stage group that has to be computed."""
    record: Mapping[str, Any] = field(default_factory=dict)
    """Of the published result, whatever input and settings it has."""
    reason: str = ""
    """Why the capture is unreadable."""


def capture_status(
    job: CaptureJob, settings: str, destination: Destination, entry: Mapping[str, Any], retry_failed: bool
) -> CaptureStatus:
    """Compares the capture's listing with the record of its result and with its entry in batch.json.

    No photograph is read: an unchanged listing (names, sizes, checksums or times) implies unchanged content. If the
    listing changed, the first task compares the content. `settings` is the batch's settings hash.
    """
    files = object_store.list_files(StoragePath(job.source))
    if not files:
        return CaptureStatus(
            "unreadable", reason=f"{job.source} does not exist or is empty; give the folder of a capture"
        )
    listing = listing_hash(files)
    record = destination.record(job.name)
    if record and not object_store.exists(destination.result(job.name) / "run.json"):
        record = {}
    if record and (record.get("settings_hash"), record.get("listing_hash")) == (settings, listing):
        return CaptureStatus("finished", listing, str(record.get("content_hash", "")), record=record)
    unchanged = entry.get("listing_hash") == listing
    failed = entry.get("state") == "failed" and entry.get("settings_hash") == settings
    if failed and unchanged and not retry_failed:
        return CaptureStatus("failed before", listing, str(entry.get("content_hash", "")), record=record)
    known = entry if unchanged else record if record.get("listing_hash") == listing else {}
    content = str(known.get("content_hash", ""))
    group = 0
    if content:
        stored = {stored.name for stored in destination.stored_groups(job.name, result_key(content, settings))}
        group = next(i for i, candidate in enumerate(STAGE_GROUPS) if candidate.name not in stored)
    return CaptureStatus("unfinished", listing, content, group, record)


class StatusChecker:
    """Determines the status of captures in threads, because requests to a store are slow."""

    def __init__(
        self,
        jobs: Iterable[CaptureJob],
        settings: str,
        destination: Destination,
        entries: Mapping[str, Mapping[str, Any]],
        retry_failed: bool,
    ) -> None:
        self._pending = deque(jobs)
        self._settings, self._destination = settings, destination
        self._entries, self._retry_failed = entries, retry_failed
        self._pool = ThreadPoolExecutor(MAX_PARALLEL_CHECKS, thread_name_prefix="hir-batch-status")
        self._running: dict[Future[CaptureStatus], CaptureJob] = {}

    @property
    def running(self) -> bool:
        return bool(self._running)

    @property
    def finished(self) -> bool:
        """Whether the status of every capture was returned."""
        return not self._pending and not self._running

    def completed(self, start_more: bool) -> Iterator[tuple[CaptureJob, CaptureStatus]]:
        """The captures whose check has ended; starts further checks if `start_more`."""
        while start_more and self._pending and len(self._running) < MAX_PARALLEL_CHECKS:
            job = self._pending.popleft()
            self._running[self._pool.submit(self._check, job)] = job
        for future in [future for future in self._running if future.done()]:
            yield self._running.pop(future), future.result()

    def close(self) -> None:
        """Cancels the checks that have not started."""
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _check(self, job: CaptureJob) -> CaptureStatus:
        try:
            entry = self._entries.get(job.name, {})
            return capture_status(job, self._settings, self._destination, entry, self._retry_failed)
        except HirError as error:
            return CaptureStatus("unreadable", reason=str(error))
