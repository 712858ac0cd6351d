"""Reading a run's documents for the page, and numbers as text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

Document = Mapping[str, Any]


def report_of(document: Document, stage: str) -> Document:
    """The report of a stage in run.json; empty where the stage did not run."""
    report: Document = document["stages"].get(stage, {}).get("report", {})
    return report


def number(value: float | None, digits: int, unit: str = "") -> str:
    """A number with `digits` decimals; a dash for None."""
    return "–" if value is None else f"{value:.{digits}f}{unit}"


def duration(seconds: float) -> str:
    """Seconds, minutes or hours."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.1f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
