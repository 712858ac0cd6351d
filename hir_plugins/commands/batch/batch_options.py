"""How a batch works."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from hir_core.config import RunConfig
from hir_plugins.commands.batch.stage_groups import Requests


@dataclass(frozen=True)
class Options:
    """How a batch works; what it makes is in `config`."""

    config: RunConfig
    requests: Requests = field(default_factory=Requests)
    address: str = "auto"
    """`auto`, `local`, or what Ray takes: `ray://host:10001`, `host:6379`."""
    tries: int = 3
    """Times that a group is begun when nodes, workers or the store fail; a broken capture is never tried twice."""
    retry_failed: bool = False
    at_once: int = 0
    """Captures in progress together; 0: as many as the cluster has room for."""
    keep_stages: bool = True
    cache: Path | None = None
    """Where workers stage files, on each node."""
