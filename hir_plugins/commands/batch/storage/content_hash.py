"""Hashes that decide whether a capture has to be processed: of its listing, its content, and the settings."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Final

from hir_core.config import RunConfig
from hir_core.errors import InputError
from hir_core.files.file_checksums import file_hash
from hir_core.files.json_documents import jsonable
from hir_core.files.light_setting import parse_light_file
from hir_plugins.commands.batch.storage.storage_path import FileStat

SETTINGS_WITHOUT_EFFECT: Final = ("checkpoint_seconds", "observers")
"""Settings that do not change the result of a run."""


def listing_hash(listing: Mapping[str, FileStat]) -> str:
    """Hash of names, sizes and versions: cheap, and different whenever the content may have changed."""
    return _hash([[name, stat.size, stat.version] for name, stat in sorted(listing.items())])


def content_hash(path: Path) -> str:
    """Hash of the names and bytes of all files of a capture (a folder or one file), independent of its location."""
    if path.is_file():
        return _hash([["", file_hash(path)]])
    files = sorted(file for file in path.rglob("*") if file.is_file())
    return _hash([[file.relative_to(path).as_posix(), file_hash(file)] for file in files])


def settings_hash(config: RunConfig) -> str:
    """Hash of all settings that change the result; for a setting that names a file, also of the file's bytes."""
    table = asdict(config)
    for name in SETTINGS_WITHOUT_EFFECT:
        del table[name]
    named_files = [[text, file_hash(path)] for text in sorted(set(_strings(table))) for path in _named_file(text)]
    return _hash([table, named_files])


def result_key(content: str, settings: str) -> str:
    """Hash of all that a result depends on: the content hash of the capture and the settings hash."""
    return _hash([content, settings])


def _hash(document: object) -> str:
    text = json.dumps(jsonable(document), sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def _strings(value: object) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for inner in value.values():
            yield from _strings(inner)
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from _strings(inner)


def _named_file(text: str) -> Iterator[Path]:
    """The file that a setting names as `FILE` or `FILE*STRENGTH`; words such as `fast` name none."""
    try:
        path, _ = parse_light_file(text)
    except InputError:
        return
    if path.suffix and len(text) < 1024 and path.is_file():
        yield path
