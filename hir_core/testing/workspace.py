"""Temporary folders of one subject under test."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class Workspace:
    """Makes empty folders, and removes them at its end."""

    _folders: list[tempfile.TemporaryDirectory[str]] = field(default_factory=list, init=False, repr=False)

    def folder(self) -> Path:
        """A new empty folder; `close` removes it."""
        self._folders.append(tempfile.TemporaryDirectory(prefix="hir-contract-", ignore_cleanup_errors=True))
        return Path(self._folders[-1].name).resolve()

    def close(self) -> None:
        """Removes the folders."""
        for folder in self._folders:
            folder.cleanup()
        self._folders.clear()
