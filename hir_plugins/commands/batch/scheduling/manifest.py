"""batch.json: the state of all captures of a batch. Only the driver writes it, always as a whole."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from typing import Any, Final, get_args

from hir_exporters.files.untrusted_json import parse_json

from hir_core.errors import InputError
from hir_plugins.commands.batch.scheduling.capture_job import CaptureJob, JobState
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.storage_path import StoragePath

FORMAT: Final = "hir-batch"
VERSION: Final = 1

MIN_WRITE_INTERVAL_S: Final = 1.0
MAX_WRITE_TIME_FRACTION: Final = 0.05
"""Of the driver's time. A large manifest is therefore written less often."""


class Manifest:
    """The file batch.json, and the time of its next update."""

    def __init__(self, path: StoragePath, header: Mapping[str, Any]) -> None:
        self._path, self._header = path, dict(header)
        self._next_write = 0.0
        self._earlier_entries: dict[str, Any] = {}

    def read(self) -> dict[str, Mapping[str, Any]]:
        """The entries of an earlier call by capture name; `InputError` if the file is no manifest of a batch."""
        content = object_store.read(self._path)
        if content is None:
            return {}
        try:
            document = parse_json(content)
        except (ValueError, RecursionError) as error:
            raise InputError(f"{self._path} is not JSON ({error}); move it away to start over") from None
        captures = document.get("captures") if isinstance(document, dict) else None
        if not isinstance(captures, dict) or document.get("format") != FORMAT or document.get("version") != VERSION:
            raise InputError(f"{self._path} is not a batch manifest of version {VERSION}; choose another destination")
        damaged = [name for name, entry in captures.items() if not _is_valid(entry)]
        if damaged:
            raise InputError(f"{self._path}: the entry of {damaged[0]!r} is damaged; move the file away to start over")
        entries: dict[str, Mapping[str, Any]] = captures
        self._earlier_entries = dict(entries)
        self._header["started"] = document.get("started", self._header.get("started"))
        return entries

    def entries(self, jobs: Iterable[CaptureJob]) -> dict[str, Any]:
        """The entries of all captures, including those that only earlier calls named."""
        return {**self._earlier_entries, **{job.name: job.manifest_entry() for job in jobs}}

    def write(self, jobs: Iterable[CaptureJob], force: bool = True) -> bool:
        """Writes the file if an update is due or `force` is set; returns whether it did."""
        started = time.monotonic()
        if not force and started < self._next_write:
            return False
        header = {"format": FORMAT, "version": VERSION, **self._header, "updated": current_time()}
        object_store.write(self._path, manifest_bytes(header, self.entries(jobs)))
        ended = time.monotonic()
        self._next_write = ended + max(MIN_WRITE_INTERVAL_S, (ended - started) / MAX_WRITE_TIME_FRACTION)
        return True


def _is_valid(entry: object) -> bool:
    """Whether an entry has the types that the summary page and the next call rely on."""
    if not isinstance(entry, dict) or entry.get("state") not in get_args(JobState):
        return False
    tables = [entry.get("psnr") or {}, entry.get("stage_seconds") or {}]
    return (
        all(isinstance(table, dict) for table in tables)
        and all(isinstance(seconds, int | float) for seconds in tables[1].values())
        and isinstance(entry.get("warnings") or [], list)
        and isinstance(entry.get("retries") or 0, int)
    )


def manifest_bytes(header: Mapping[str, Any], entries: Mapping[str, Any]) -> bytes:
    """JSON with one capture per line: fast to write for a million captures, and easy to search."""
    head = json.dumps(header, sort_keys=True, ensure_ascii=False)[:-1]
    encode = json.JSONEncoder(sort_keys=True, ensure_ascii=False, allow_nan=False).encode
    lines = ",\n".join(f"{encode(name)}: {encode(entries[name])}" for name in sorted(entries))
    return f'{head}, "captures": {{\n{lines}\n}}}}\n'.encode()


def current_time() -> str:
    """Date and time in UTC, ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="seconds")
