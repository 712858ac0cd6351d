"""batch.json: all captures of a batch and how far each is; written whole, by the driver alone."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from typing import Any, Final, get_args

from hir_core.errors import InputError
from hir_plugins.commands.batch.scheduling.capture_chain import Chain, State
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.object_store import Place

FORMAT: Final = "hir-batch"
VERSION: Final = 1

LEAST_SECONDS: Final = 1.0
SHARE: Final = 0.05
"""Of the driver's time, at most, goes into writing the manifest: a large one is written less often."""


class Manifest:
    """The file, and when it is due again."""

    def __init__(self, at: Place, facts: Mapping[str, Any]) -> None:
        self._at, self._facts = at, dict(facts)
        self._due = 0.0
        self._others: dict[str, Any] = {}

    def read(self) -> dict[str, Mapping[str, Any]]:
        """The entries of an earlier call, by name; a file that is no batch's is an `InputError`."""
        content = object_store.read(self._at)
        if content is None:
            return {}
        try:
            document = json.loads(content)
        except (ValueError, RecursionError) as error:
            raise InputError(f"{self._at} is not JSON ({error}); move it away to begin anew") from None
        captures = document.get("captures") if isinstance(document, dict) else None
        if not isinstance(captures, dict) or document.get("format") != FORMAT or document.get("version") != VERSION:
            raise InputError(f"{self._at} is no batch's manifest of version {VERSION}; choose another destination")
        broken = [name for name, entry in captures.items() if not _sound(entry)]
        if broken:
            raise InputError(f"{self._at}: the entry of {broken[0]!r} is damaged; move the file away to begin anew")
        found: dict[str, Mapping[str, Any]] = captures
        self._others = dict(found)
        self._facts["started"] = document.get("started", self._facts.get("started"))
        return found

    def captures(self, chains: Iterable[Chain]) -> dict[str, Any]:
        """The entries of all captures; those of earlier calls that this one does not name stay."""
        return {**self._others, **{chain.name: chain.entry() for chain in chains}}

    def write(self, chains: Iterable[Chain], force: bool = True) -> bool:
        """Writes the file if it is due or must be, and says whether it did."""
        began = time.monotonic()
        if not force and began < self._due:
            return False
        facts = {"format": FORMAT, "version": VERSION, **self._facts, "updated": now_text()}
        object_store.write(self._at, document_bytes(facts, self.captures(chains)))
        ended = time.monotonic()
        self._due = ended + max(LEAST_SECONDS, (ended - began) / SHARE)
        return True


def _sound(entry: Any) -> bool:
    """Has an entry all that the page and the next call take from it?"""
    if not isinstance(entry, dict) or entry.get("state") not in get_args(State):
        return False
    tables = [entry.get("psnr") or {}, entry.get("stage_seconds") or {}]
    return (
        all(isinstance(table, dict) for table in tables)
        and all(isinstance(seconds, int | float) for seconds in tables[1].values())
        and isinstance(entry.get("warnings") or [], list)
        and isinstance(entry.get("retries") or 0, int)
    )


def document_bytes(facts: Mapping[str, Any], captures: Mapping[str, Any]) -> bytes:
    """A capture a line: quick to write for a million of them, and to search by line."""
    head = json.dumps(facts, sort_keys=True, ensure_ascii=False)[:-1]
    encode = json.JSONEncoder(sort_keys=True, ensure_ascii=False, allow_nan=False).encode
    lines = ",\n".join(f"{encode(name)}: {encode(captures[name])}" for name in sorted(captures))
    return f'{head}, "captures": {{\n{lines}\n}}}}\n'.encode()


def now_text() -> str:
    """The date and time, in UTC."""
    return datetime.now(UTC).isoformat(timespec="seconds")
