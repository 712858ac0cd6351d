"""Observer: the scalars of every stage as TensorBoard curves."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hir_core.errors import MissingExtraError
from hir_core.plugins import hookimpl
from hir_core.plugins.options import build_options
from hir_plugins.observers.options import TensorBoardOptions

if TYPE_CHECKING:
    from hir_core.config import RunConfig
    from hir_core.plugins.progress import Progress
    from hir_core.scene import Scene

NAME = "tensorboard"


class TensorBoardObserver:
    """Writes to `RUN/tensorboard/<stage>` if the settings have a table `observers.tensorboard`."""

    def __init__(self) -> None:
        self._folder: Path | None = None
        self._flush_seconds = 10
        self._writer: Any = None
        self._stage = ""

    @hookimpl
    def hir_register_observers(self) -> Mapping[str, type]:
        return {NAME: TensorBoardOptions}

    @hookimpl
    def hir_run_started(self, config: RunConfig, run_folder: Path) -> None:
        table = config.observers.get(NAME, False)
        self._folder = None
        if table is False:
            return
        try:
            import torch.utils.tensorboard  # noqa: F401 - only where it was asked for
        except ImportError:
            raise MissingExtraError(
                "observer 'tensorboard' needs tensorboard; install it with: pip install 'hir[tensorboard]'"
            ) from None
        self._folder = run_folder / NAME
        self._flush_seconds = build_options(TensorBoardOptions, table, "observer 'tensorboard'").flush_seconds

    @hookimpl
    def hir_progress(self, progress: Progress) -> None:
        if self._folder is None:
            return
        writer = self._writer_of(progress.stage)
        for name, values in progress.scalars.items():
            first = progress.step - len(values) + 1
            for step, value in enumerate(values.tolist(), first):
                writer.add_scalar(name, value, step)

    @hookimpl
    def hir_stage_finished(self, stage: str, scene: Scene | None, report: Mapping[str, object]) -> None:
        if self._folder is None:
            return
        writer = self._writer_of(stage)
        for name, value in report.items():
            if isinstance(value, int | float) and not isinstance(value, bool):
                writer.add_scalar(f"report/{name}", value)
        writer.close()
        self._writer = None

    def _writer_of(self, stage: str) -> Any:
        from torch.utils.tensorboard import SummaryWriter

        if self._writer is None or self._stage != stage:
            if self._writer is not None:
                self._writer.close()
            assert self._folder is not None
            self._writer = SummaryWriter(str(self._folder / stage), flush_secs=self._flush_seconds)
            self._stage = stage
        return self._writer
