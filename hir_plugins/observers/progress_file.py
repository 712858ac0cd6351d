"""Observer: the progress of a run as a small JSON file, for programs that watch it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from hir_core.files.json_documents import write_json
from hir_core.plugins import hookimpl
from hir_core.plugins.options import build_options
from hir_core.plugins.progress import Throttle
from hir_core.terminal.progress_bar import describe_error
from hir_plugins.observers.options import ProgressFileOptions

if TYPE_CHECKING:
    from hir_core.config import RunConfig
    from hir_core.plugins.progress import Progress

NAME = "progress_file"
FILE = "progress.json"


class ProgressFileObserver:
    """Writes `RUN/progress.json` if the settings have a table `observers.progress_file`."""

    def __init__(self) -> None:
        self._path: Path | None = None
        self._throttle = Throttle(first_at_once=True)
        self._stage = ""
        self._error = ""

    @hookimpl
    def hir_register_observers(self) -> Mapping[str, type]:
        return {NAME: ProgressFileOptions}

    @hookimpl
    def hir_run_started(self, config: RunConfig, run_folder: Path) -> None:
        table = config.observers.get(NAME, False)
        self._path = None if table is False else run_folder / FILE
        self._stage = ""
        if self._path is not None and table is not False:
            options = build_options(ProgressFileOptions, table, f"observer {NAME!r}")
            self._throttle = Throttle(options.interval_seconds, first_at_once=True)
            self._path.unlink(missing_ok=True)  # that of an earlier call

    @hookimpl
    def hir_progress(self, progress: Progress) -> None:
        new_stage, complete = progress.stage != self._stage, progress.step >= progress.steps
        self._error = describe_error(progress) or ("" if new_stage else self._error)
        if self._path is None or not (new_stage or complete or self._throttle.ready):
            return
        self._stage = progress.stage
        self._throttle.restart()
        write_json(
            self._path,
            {
                "stage": progress.stage,
                "step": progress.step,
                "steps": progress.steps,
                "seconds": progress.seconds,
                "seconds_left": progress.seconds_left,
                "message": progress.message,
                "error": self._error,
            },
        )
