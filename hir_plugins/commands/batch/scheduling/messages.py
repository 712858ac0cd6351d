"""What travels between the driver and the workers: a task's order, its progress, its outcome."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from hir_core.config import RunConfig


@dataclass(frozen=True)
class Job:
    """One group of one capture."""

    name: str
    source: str
    destination: str
    group: int
    """Index into `GROUPS`."""
    config: RunConfig
    settings: str
    """Mark of the settings."""
    owner: str
    """Token of the batch's lease: a worker whose batch was taken over publishes nothing."""
    version: str
    """Of the driver's hir; a worker of another one refuses."""
    threads: int = 1
    attempt: int = 1
    listing: str = ""
    """Mark of the capture's listing, as the driver saw it."""
    content: str = ""
    """Mark of the capture's bytes where it is known already."""
    finished: tuple[str, str] = ("", "")
    """Marks of content and settings of the finished result that is there, if any."""
    cache: str = ""
    keep_stages: bool = True
    tell_seconds: float = 0.5
    """Between two things that the worker says of its progress."""


@dataclass(frozen=True)
class Told:
    """What a worker says while it works."""

    name: str
    group: int
    attempt: int
    node: str
    pid: int
    stage: str = ""
    step: int = 0
    steps: int = 0
    seconds_left: float = 0.0
    sentence: str = ""


@dataclass(frozen=True)
class Outcome:
    """How one task ended."""

    state: Literal["done", "unchanged", "failed", "trouble"]
    """`failed`: the capture or the settings are at fault, or a bug. `trouble`: nothing is said about the capture."""
    reason: str = ""
    """One sentence for `failed` and `trouble`."""
    content: str = ""
    node: str = ""
    pid: int = 0
    seconds: Mapping[str, float] = field(default_factory=dict)
    """`stage`, `compute`, `store`: to bring the input, to run the stages, to keep the result."""
    bytes_stored: int = 0
    lines: tuple[str, ...] = ()
    """For the capture's log."""
    reused: bool = False
    """Whether an earlier task had finished the group, and this one only found that out."""
    record: Mapping[str, Any] = field(default_factory=dict)
    """After the last group: what the summary shows of the result."""
