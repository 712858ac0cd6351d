"""Marks that decide whether work is done: of a capture's listing, of its bytes, and of the settings."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from hir_core.capture.capture_store import file_hash
from hir_core.config import RunConfig
from hir_core.files.json_documents import jsonable
from hir_plugins.commands.batch.storage.object_store import Stamp

WITHOUT_EFFECT: Final = ("checkpoint_seconds", "observers")
"""Settings that change how a run is watched or kept, not what it makes."""


def listing_mark(listed: Mapping[str, Stamp]) -> str:
    """Of names, sizes and the store's own checksums or times: cheap, and new whenever the content may be."""
    return _digest([[name, stamp.size, stamp.mark] for name, stamp in sorted(listed.items())])


def content_mark(path: Path) -> str:
    """Of the names and bytes of all files of a capture, a folder or one file: the same wherever it lies."""
    if path.is_file():
        return _digest([["", file_hash(path)]])
    found = sorted(file for file in path.rglob("*") if file.is_file())
    return _digest([[file.relative_to(path).as_posix(), file_hash(file)] for file in found])


def settings_mark(config: RunConfig) -> str:
    """Of all settings that a result depends on; one that names a file counts with the file's bytes."""
    table = asdict(config)
    for name in WITHOUT_EFFECT:
        del table[name]
    named = [[text, file_hash(path)] for text in sorted(set(_strings(table))) for path in _named_file(text)]
    return _digest([table, named])


def work_mark(content: str, settings: str) -> str:
    """Of input and settings together: what a result is the result of."""
    return _digest([content, settings])


def _digest(plain: Any) -> str:
    text = json.dumps(jsonable(plain), sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def _strings(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for inner in value.values():
            yield from _strings(inner)
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from _strings(inner)


def _named_file(text: str) -> Iterator[Path]:
    """The file that a setting names, `FILE` or `FILE*STRENGTH`; words such as `fast` name none."""
    path = Path(text.rpartition("*")[0] or text)
    if path.suffix and len(text) < 1024 and path.is_file():
        yield path
