"""What studies that store one line of JSON a run share: their command line, and reading and adding such lines."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any


def study_arguments(description: str | None, store: Path) -> argparse.ArgumentParser:
    """Captures, seeds, the file of stored lines, and `--table FILE` to print its table."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="*", type=Path)
    parser.add_argument("--store", type=Path, default=store)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--table", type=Path)
    return parser


def stored_rows(store: Path) -> list[dict[str, Any]]:
    """All lines of a file; none where there is no file."""
    return [json.loads(line) for line in store.read_text(encoding="utf-8").splitlines()] if store.exists() else []


def add_rows(store: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Adds lines to a file and prints them."""
    lines = [json.dumps(row, sort_keys=True) for row in rows]
    with store.open("a", encoding="utf-8") as file:
        file.writelines(line + "\n" for line in lines)
    print("\n".join(lines), flush=True)
