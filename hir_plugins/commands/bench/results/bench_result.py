"""What a benchmark gives: rows of seconds, memory and error, with the machine and versions they were taken on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import TypeAdapter

from hir_core.errors import InputError
from hir_core.files.json_documents import read_json, write_json
from hir_core.run.machine import describe_machine, versions

FORMAT: Final = "hir-bench"
VERSION: Final = 1

Role = Literal["ours", "reference", "peer"]
"""A component that is installed, what it is judged by, or another program on the same task."""

Case = Mapping[str, str | int | float]


@dataclass(frozen=True)
class Timing:
    """Wall-clock seconds of repeated runs, and what memory they took."""

    minimum: float
    median: float
    maximum: float
    repeats: int
    cpu: float
    """Processor seconds of the cheapest run: other programs on the machine count less than by the wall clock."""
    memory_bytes: int | None = None
    """Peak resident size above that before the runs; None where the system does not tell."""


@dataclass(frozen=True)
class Row:
    """One method on one case."""

    case: Case
    method: str
    role: Role
    timing: Timing | None
    errors: Mapping[str, float] = field(default_factory=dict)
    """By name, with its unit; smaller is better unless the name ends in dB."""
    note: str = ""
    """Why a figure is missing, or what it leaves out."""

    @property
    def key(self) -> str:
        """What two result files are matched by."""
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

    def write(self, path: Path) -> None:
        """As JSON; cases and errors as pairs, for their order is that of a table's columns."""
        document: dict[str, Any] = {"format": FORMAT, "version": VERSION} | asdict(self)
        for row in document["rows"]:
            row |= {"case": list(row["case"].items()), "errors": list(row["errors"].items())}
        write_json(path, document)

    @classmethod
    def read(cls, path: Path) -> Result:
        """What `write` wrote; anything else is an error that names the file."""
        document = read_json(path)
        if document.get("format") != FORMAT or document.get("version") != VERSION:
            raise InputError(f"{path} is not a result of hir bench that this program reads")
        try:
            rows = [row | {"case": dict(row["case"]), "errors": dict(row["errors"])} for row in document["rows"]]
            known = ("suite", "machine", "versions", "date", "settings")
            fields = {name: document[name] for name in known} | {"rows": rows}
            return TypeAdapter(cls).validate_python(fields)
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{path}: a row or field is malformed ({' '.join(str(error).split())})") from error


def kinds(rows: Sequence[Row]) -> list[list[Row]]:
    """Rows whose cases are told by the same names together, in the order of their first ones."""
    found = dict.fromkeys(tuple(row.case) for row in rows)
    return [[row for row in rows if tuple(row.case) == kind] for kind in found]


def error_names(rows: Sequence[Row]) -> list[str]:
    """Names of all errors, in the order in which they come up."""
    return list(dict.fromkeys(name for row in rows for name in row.errors))
