"""The result of a suite: rows of time, memory and error, with the machine and the versions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import TypeAdapter

from hir_core.errors import InputError
from hir_core.files.json_documents import read_json, write_json
from hir_core.run.machine import describe_machine, source_commit, versions

FORMAT: Final = "hir-bench"
VERSION: Final = 1

PAIRS: Final = ("case", "errors", "labels")
"""Fields of a row that a file holds as lists of pairs; older files have no labels."""

Role = Literal["ours", "reference", "peer"]
"""An installed component, the reference that it is compared with, or another program on the same task."""

Case = Mapping[str, str | int | float]
"""What a row measures, such as the number of triangles, by name."""


@dataclass(frozen=True)
class Timing:
    """Wall-clock seconds of repeated calls, and their memory."""

    minimum: float
    median: float
    maximum: float
    repeats: int
    cpu: float
    """CPU seconds of the fastest call; other programs on the machine affect them less than the wall-clock time."""
    memory_bytes: int | None = None
    """Peak resident size minus the size before the calls; None if the system does not report it."""


@dataclass(frozen=True)
class Row:
    """One method on one case."""

    case: Case
    method: str
    role: Role
    timing: Timing | None
    errors: Mapping[str, float] = field(default_factory=dict)
    """By name, with the unit; smaller is better unless the name contains dB."""
    note: str = ""
    """Why a figure is missing, or what it does not include."""
    labels: Mapping[str, str] = field(default_factory=dict)
    """Findings that are no numbers, by the name of their column."""

    @property
    def key(self) -> str:
        """Identifies the row in another result of the same suite."""
        return " · ".join([*(f"{name} {value}" for name, value in self.case.items()), self.method])


@dataclass(frozen=True)
class Result:
    """One suite on one machine."""

    suite: str
    rows: tuple[Row, ...]
    machine: Mapping[str, Any] = field(default_factory=lambda: describe_machine("cpu"))
    versions: Mapping[str, str] = field(default_factory=versions)
    date: str = field(default_factory=lambda: datetime.now(UTC).date().isoformat())
    settings: Mapping[str, Any] = field(default_factory=dict)
    commit: str = field(default_factory=source_commit)
    """Of the code that was measured; empty where it is unknown."""

    def write(self, path: Path) -> None:
        """Writes JSON; mappings are lists of pairs, because their order is the order of a table's columns."""
        document: dict[str, Any] = {"format": FORMAT, "version": VERSION} | asdict(self)
        for row in document["rows"]:
            row |= {name: list(row[name].items()) for name in PAIRS}
        write_json(path, document)

    @classmethod
    def read(cls, path: Path) -> Result:
        """Reads what `write` wrote; raises `InputError`, which names the file, for anything else."""
        document = read_json(path)
        if document.get("format") != FORMAT or document.get("version") != VERSION:
            raise InputError(f"{path} is not a result of hir bench, or of an unsupported version")
        try:
            stored = TypeAdapter(list[dict[str, Any]]).validate_python(document["rows"])
            rows = [row | {name: dict(row.get(name, ())) for name in PAIRS} for row in stored]
            names = ("suite", "machine", "versions", "date", "settings")
            fields = {name: document[name] for name in names} | {"rows": rows, "commit": document.get("commit", "")}
            return TypeAdapter(cls).validate_python(fields)
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{path}: a row or field is malformed ({' '.join(str(error).split())})") from error


def group_by_case_names(rows: Sequence[Row]) -> list[list[Row]]:
    """Rows whose cases have the same names, in the order of their first rows."""
    kinds = dict.fromkeys(tuple(row.case) for row in rows)
    return [[row for row in rows if tuple(row.case) == kind] for kind in kinds]


def error_names(rows: Sequence[Row]) -> list[str]:
    """The names of all errors, in the order in which they first occur."""
    return list(dict.fromkeys(name for row in rows for name in row.errors))
