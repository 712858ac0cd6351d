"""The options of a batch."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from hir_core.config import RunConfig
from hir_plugins.commands.batch.resource_requests import ResourceRequests


@dataclass(frozen=True)
class BatchOptions:
    """How a batch is run; `config` is what each capture is reconstructed with."""

    config: RunConfig
    requests: ResourceRequests = field(default_factory=ResourceRequests)
    address: str = "auto"
    """`auto`, `local`, or an address that Ray accepts: `ray://host:10001`, `host:6379`."""
    attempts: int = 3
    """Times that a task is started if nodes, workers or the store fail. A broken capture is never retried."""
    retry_failed: bool = False
    """Whether captures that failed in an earlier call are processed again."""
    max_in_progress: int = 0
    """Captures that are processed at the same time; 0: as many as the cluster has capacity for."""
    keep_stages: bool = True
    """Whether results contain `stages/`."""
    cache: Path | None = None
    """The folder for local files on each node; None: among the temporary files."""
