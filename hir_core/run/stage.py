"""What a stage of a run is: declared once, with its settings, its function and the way its result goes to disk."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from hir_core.files.json_documents import jsonable

if TYPE_CHECKING:
    from hir_core.run.stage_context import StageContext
    from hir_core.scene import Scene

State = TypeVar("State")
Value = TypeVar("Value")


@dataclass(frozen=True)
class StageResult(Generic[Value]):
    """What a stage computes."""

    value: Value
    report: Any
    """A dataclass; run.json holds its fields."""

    def report_document(self) -> dict[str, Any]:
        """The report as JSON-compatible values."""
        return report_document(self.report)


@dataclass(frozen=True)
class Stage(Generic[State, Value]):
    """One stage of a run. `State` is the immutable record of all earlier results, which each stage extends."""

    name: str
    settings: Callable[[State], Any]
    """Settings and file hashes that the result depends on, beside the results of earlier stages; JSON-compatible."""
    compute: Callable[[State, StageContext], StageResult[Value]]
    save: Callable[[State, Value, Path], None]
    """Writes the value into the stage's folder, so that `load` returns the same value."""
    load: Callable[[State, Path], Value]
    """Reads the value; raises `InputError` where its files are damaged."""
    extend: Callable[[State, Value], State]
    """The state with this stage's value."""
    scene: Callable[[State], Scene | None] = lambda state: None
    """The scene that observers of `hir_stage_finished` get, from the extended state."""
    reads_back: bool = False
    """Later stages get the value as `load` reads it, so that a resumed run continues with the same bits."""
    folders: tuple[str, ...] = ()
    """Folders of the run outside the stage's own that `compute` or `save` writes, such as `exports`."""


def report_document(report: Any) -> dict[str, Any]:
    """A report dataclass as JSON-compatible values: `as_document()` where it has one, else its fields."""
    if hasattr(report, "as_document"):
        document = report.as_document()
    elif is_dataclass(report) and not isinstance(report, type):
        document = asdict(report)
    else:
        raise TypeError(f"a stage's report must be a dataclass, not {type(report).__name__}")
    return dict(jsonable(document))


@dataclass(frozen=True)
class SkippedStageReport:
    """The report of a stage that the settings switch off."""

    enabled: bool = False
