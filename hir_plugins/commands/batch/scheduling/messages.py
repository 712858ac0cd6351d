"""The messages between driver and workers: a task's specification, its progress, its outcome."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from hir_core.config import RunConfig

OutcomeState = Literal["done", "unchanged", "failed", "infrastructure_error"]
"""`unchanged`: the published result is still valid. `failed`: the capture or the settings are at fault, or there is a
bug. `infrastructure_error`: the task failed for a reason outside its capture and may be retried."""


@dataclass(frozen=True)
class TaskSpec:
    """One stage group of one capture."""

    name: str
    """Of the capture."""
    source: str
    destination: str
    group: int
    """Index into `STAGE_GROUPS`."""
    config: RunConfig
    settings_hash: str
    lease_token: str
    """A worker publishes nothing if another batch has acquired the lease."""
    version: str
    """The driver's version of hir; a worker with another version refuses the task."""
    threads: int = 1
    attempt: int = 1
    listing_hash: str = ""
    """Of the capture, as the driver listed it."""
    content_hash: str = ""
    """Of the capture, if it is known already."""
    published: tuple[str, str] = ("", "")
    """Content hash and settings hash of the published result, if there is one."""
    cache: str = ""
    keep_stages: bool = True
    progress_interval_s: float = 0.5
    """Least seconds between two progress messages."""


@dataclass(frozen=True)
class ProgressMessage:
    """The progress of a task."""

    name: str
    group: int
    attempt: int
    node: str
    pid: int
    stage: str = ""
    step: int = 0
    steps: int = 0
    seconds_left: float = 0.0


@dataclass(frozen=True)
class TaskOutcome:
    """How one task ended."""

    state: OutcomeState
    reason: str = ""
    """One sentence for `failed` and `infrastructure_error`."""
    content_hash: str = ""
    node: str = ""
    pid: int = 0
    seconds: Mapping[str, float] = field(default_factory=dict)
    """`stage`, `compute`, `store`: to fetch the input, to run the stages, to store the result."""
    bytes_stored: int = 0
    log_lines: tuple[str, ...] = ()
    reused: bool = False
    """Whether an earlier task had finished the stages, so that this task computed nothing."""
    record: Mapping[str, Any] = field(default_factory=dict)
    """After the last group: the record of the finished capture."""
