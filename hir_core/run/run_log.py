"""log.txt of a run: messages with their time, in rotating files of bounded size."""

from __future__ import annotations

import logging
from contextlib import closing
from logging.handlers import RotatingFileHandler
from pathlib import Path

MAX_LOG_BYTES = 1 << 20
BACKUP_FILES = 3
"""log.txt.1 is the newest backup, log.txt.3 the oldest."""


def write_log(path: Path, sentence: str) -> None:
    """Appends a line. If it cannot be written (full disk, removed folder), the line is dropped and the run goes on."""
    record = logging.LogRecord("hir", logging.INFO, "", 0, " ".join(sentence.split()), None, None)
    try:
        handler = RotatingFileHandler(path, maxBytes=MAX_LOG_BYTES, backupCount=BACKUP_FILES, encoding="utf-8")
        with closing(handler):
            handler.setFormatter(logging.Formatter("%(asctime)s %(message)s"))
            handler.handleError = _ignore  # type: ignore[method-assign]
            handler.emit(record)
    except OSError:
        pass


def _ignore(record: logging.LogRecord) -> None:
    """Drops a line that cannot be written."""
