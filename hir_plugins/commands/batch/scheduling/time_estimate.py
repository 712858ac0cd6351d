"""The remaining time of a capture and of a batch, estimated from the tasks that have finished."""

from __future__ import annotations

from collections.abc import Iterable
from statistics import median
from typing import Final

from hir_plugins.commands.batch.scheduling.capture_job import CaptureJob
from hir_plugins.commands.batch.stage_groups import STAGE_GROUPS

MEDIAN_WINDOW: Final = 200
"""The number of most recent tasks of a group from which the median is computed."""


class TimeEstimate:
    """Records how long the tasks of each stage group take."""

    def __init__(self) -> None:
        self._seconds: dict[str, list[float]] = {group.name: [] for group in STAGE_GROUPS}

    def record(self, group: int, seconds: float) -> None:
        """Adds the duration of a finished task on its worker."""
        recorded = self._seconds[STAGE_GROUPS[group].name]
        recorded.append(seconds)
        del recorded[:-MEDIAN_WINDOW]

    def median_seconds(self, group: int) -> float | None:
        """The median duration of a group; None until a task of it has finished."""
        recorded = self._seconds[STAGE_GROUPS[group].name]
        return median(recorded) if recorded else None

    def job_seconds_left(self, job: CaptureJob, running_s: float = 0.0) -> float | None:
        """Seconds until a capture is done if its current task has run for `running_s`; None if a median is missing."""
        if job.state in ("done", "failed"):
            return 0.0
        medians = self._medians(job.group)
        return None if medians is None else max(medians[0] - running_s, 0.0) + sum(medians[1:])

    def batch_seconds_left(self, started: Iterable[CaptureJob], waiting: int, parallel: int) -> float | None:
        """Seconds until the started captures and `waiting` others are done if `parallel` are processed at a time."""
        medians = self._medians(0)
        if medians is None:
            return None
        left = [self.job_seconds_left(job) for job in started]
        return (sum(value for value in left if value is not None) + waiting * sum(medians)) / max(parallel, 1)

    def _medians(self, first_group: int) -> list[float] | None:
        medians = [self.median_seconds(group) for group in range(first_group, len(STAGE_GROUPS))]
        known = [seconds for seconds in medians if seconds is not None]
        return known if len(known) == len(medians) else None
