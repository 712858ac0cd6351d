"""What studies that store one line of JSON a run share: their command line, and reading and adding such lines."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hir_core.run.machine import describe_machine, source_commit


def study_arguments(
    description: str | None, store: Path, table: Callable[[list[dict[str, Any]]], str]
) -> argparse.Namespace:
    """`captures`, `seeds` and `store`, the file of stored lines; with `--table FILE` prints its table and ends."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="*", type=Path)
    parser.add_argument("--store", type=Path, default=store, help="file of stored lines")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--table", type=Path, metavar="FILE", help="print the table of stored lines, measure nothing")
    options = parsed(parser, table)
    if not options.captures:
        parser.error("name captures, or --table")
    return options


def run_arguments(
    parser: argparse.ArgumentParser, store: Path, table: Callable[[list[dict[str, Any]]], str]
) -> argparse.Namespace:
    """Arguments of a benchmark that renders captures of `recipes` and stores a line for each whole run; with
    `--table FILE` prints its table and ends.
    """
    parser.add_argument("--workspace", type=Path, help="folder for captures and runs")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--store", type=Path, default=store, help="file of stored lines")
    parser.add_argument("--make-only", action="store_true", help="render captures, run nothing")
    parser.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba's variant")
    parser.add_argument("--table", type=Path, metavar="FILE", help="print the table of stored lines, measure nothing")
    options = parsed(parser, table)
    if not options.recipes or options.workspace is None:
        parser.error("name recipes and --workspace, or --table")
    return options


def parsed(parser: argparse.ArgumentParser, table: Callable[[list[dict[str, Any]]], str]) -> argparse.Namespace:
    """The arguments; with `--table FILE` prints its table and ends."""
    options = parser.parse_args()
    if options.table is not None:
        if not options.table.is_file():
            parser.error(f"{options.table} does not exist; give a file that --store wrote")
        print(table(stored_rows(options.table)))
        raise SystemExit(0)
    return options


def provenance() -> dict[str, Any]:
    """What every stored figure carries: commit, date and machine."""
    return {
        "commit": source_commit(),
        "date": datetime.now(UTC).date().isoformat(),
        "machine": describe_machine("cpu"),
    }


def stored_rows(store: Path) -> list[dict[str, Any]]:
    """All lines of a file; none where there is no file."""
    return [json.loads(line) for line in store.read_text(encoding="utf-8").splitlines()] if store.exists() else []


def add_rows(store: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Adds lines to a file and prints them."""
    lines = [json.dumps(row, sort_keys=True) for row in rows]
    with store.open("a", encoding="utf-8") as file:
        file.writelines(line + "\n" for line in lines)
    print("\n".join(lines), flush=True)
