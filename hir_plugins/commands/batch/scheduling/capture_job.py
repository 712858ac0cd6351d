"""The state of one capture in a batch, and its transitions after each task."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from hir_core.files.json_documents import jsonable
from hir_plugins.commands.batch.retries import RetryPolicy
from hir_plugins.commands.batch.scheduling.messages import TaskOutcome
from hir_plugins.commands.batch.stage_groups import STAGE_GROUPS

JobState = Literal["waiting", "running", "done", "failed"]
Transition = Literal["next group", "done", "unchanged", "retry", "failed"]

RECORD_KEYS = ("psnr", "stage_seconds", "peak_memory_bytes", "photographs", "triangles", "warnings", "bytes")
"""What batch.json repeats from a capture's record."""


@dataclass(slots=True)
class CaptureJob:
    """One capture of a batch: a sequence of tasks, one for each stage group. Only the driver changes it."""

    name: str
    source: str
    state: JobState = "waiting"
    group: int = 0
    """Index into `STAGE_GROUPS` of the running or the next task."""
    attempt: int = 0
    """Tasks submitted so far."""
    failures: int = 0
    """Infrastructure errors of the current group."""
    retries: int = 0
    """Infrastructure errors of all groups, earlier calls included."""
    not_before: float = 0.0
    """`time.monotonic()` before which the next task is not submitted."""
    reason: str = ""
    listing_hash: str = ""
    content_hash: str = ""
    settings_hash: str = ""
    published: tuple[str, str] = ("", "")
    """Content hash and settings hash of the result that an earlier call published, if there is one."""
    seconds: dict[str, dict[str, float]] = field(default_factory=dict)
    """For each group: `stage`, `compute`, `store`, and `wall` from submission to outcome."""
    record: dict[str, Any] = field(default_factory=dict)
    """Of the published result, without its thumbnail."""
    log_lines: list[str] = field(default_factory=list)

    def apply(self, outcome: TaskOutcome, policy: RetryPolicy, now: float, jitter: float) -> Transition:
        """Applies the outcome of the running task; `now` and `jitter` in 0…1 set the time of a retry."""
        self.log_lines += outcome.log_lines
        self.content_hash = outcome.content_hash or self.content_hash
        group = STAGE_GROUPS[self.group].name
        if outcome.state in ("done", "unchanged"):
            if not outcome.reused:
                self.seconds.setdefault(group, {}).update(outcome.seconds)
            self.failures = 0
            if outcome.state == "done" and self.group + 1 < len(STAGE_GROUPS):
                self.group += 1
                self.state = "waiting"
                return "next group"
            self.state, self.reason = "done", ""
            if outcome.state == "unchanged":
                return "unchanged"
            self.record = jsonable({key: value for key, value in outcome.record.items() if key != "thumbnail"})
            return "done"
        if outcome.state == "infrastructure_error" and self.failures + 1 < policy.attempts:
            self.failures += 1
            self.retries += 1
            self.state = "waiting"
            self.not_before = now + policy.wait_s(self.failures, jitter)
            return "retry"
        retried = outcome.state == "infrastructure_error" and policy.attempts > 1
        attempts = f" ({policy.attempts} attempts)" if retried else ""
        self.state, self.reason = "failed", f"{group}: {outcome.reason}{attempts}"
        return "failed"

    def manifest_entry(self) -> dict[str, Any]:
        """The entry of the capture in batch.json."""
        names = ("source", "state", "reason", "listing_hash", "content_hash", "settings_hash", "seconds", "retries")
        entry = {name: getattr(self, name) for name in names}
        if self.state != "done":
            entry["group"] = STAGE_GROUPS[self.group].name
        return entry | {name: self.record[name] for name in RECORD_KEYS if name in self.record}

    def restore(self, entry: Mapping[str, Any]) -> None:
        """Restores what an earlier call wrote to batch.json; damaged values are ignored."""
        for name in ("listing_hash", "content_hash", "settings_hash", "reason"):
            value = entry.get(name)
            setattr(self, name, value if isinstance(value, str) else "")
        retries = entry.get("retries")
        self.retries = retries if isinstance(retries, int) else 0
        seconds = entry.get("seconds")
        if isinstance(seconds, dict):
            self.seconds = {str(k): dict(v) for k, v in seconds.items() if isinstance(v, dict)}

    def set_published(self, record: Mapping[str, Any]) -> None:
        """Notes the record of the published result, whatever input and settings it has."""
        self.record = {key: value for key, value in record.items() if key != "thumbnail"}
        self.published = (str(record.get("content_hash", "")), str(record.get("settings_hash", "")))
