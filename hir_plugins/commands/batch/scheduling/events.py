"""What a batch tells while it works, and what it has handed out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from hir_plugins.commands.batch.scheduling.capture_chain import Chain
from hir_plugins.commands.batch.scheduling.messages import Told


@dataclass(frozen=True)
class Event:
    """Something that happened."""

    name: str
    capture: str = ""
    facts: Mapping[str, Any] = field(default_factory=dict)


@dataclass
class Running:
    """A task that was handed out."""

    chain: Chain
    began: float
    told: Told | None = None
    """The last that its worker said."""
