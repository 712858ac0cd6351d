"""log.txt of a run: what was said and when, in files that never grow large."""

from __future__ import annotations

import logging
from contextlib import closing
from logging.handlers import RotatingFileHandler
from pathlib import Path

MOST_BYTES = 1 << 20
BACKUPS = 3
"""log.txt.1 is the one before, log.txt.3 the oldest that is kept."""


def write_log(path: Path, sentence: str) -> None:
    """Appends a line. A disk that is full, or a folder that is gone, loses the line and not the run."""
    record = logging.LogRecord("hir", logging.INFO, "", 0, " ".join(sentence.split()), None, None)
    try:
        handler = RotatingFileHandler(path, maxBytes=MOST_BYTES, backupCount=BACKUPS, encoding="utf-8")
        with closing(handler):
            handler.setFormatter(logging.Formatter("%(asctime)s %(message)s"))
            handler.handleError = _ignore  # type: ignore[method-assign]
            handler.emit(record)
    except OSError:
        pass


def _ignore(record: logging.LogRecord) -> None:
    """A line that cannot be written is lost."""
