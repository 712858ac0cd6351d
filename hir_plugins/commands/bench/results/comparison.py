"""Compares two results row by row: ratios of time, memory and errors."""

from __future__ import annotations

from dataclasses import dataclass

from hir_plugins.commands.bench.results.bench_result import Result, Row
from hir_plugins.commands.bench.results.markdown_tables import three_digits


@dataclass(frozen=True)
class RowComparison:
    """A row of the new result relative to the same row of the old one."""

    key: str
    seconds: float | None
    """New over old; below 1 is faster."""
    significant: bool
    """Whether the ranges of the repetitions do not overlap."""
    memory: float | None
    """New over old."""
    errors: dict[str, float]
    """New over old; for dB, new minus old."""


def compare_results(old: Result, new: Result) -> list[RowComparison]:
    """The rows that both results have, in the order of the old one."""
    new_rows = {row.key: row for row in new.rows}
    return [_compare_rows(row, new_rows[row.key]) for row in old.rows if row.key in new_rows]


def unmatched_keys(old: Result, new: Result) -> tuple[list[str], list[str]]:
    """The keys of the rows that only the old result has, and only the new one."""
    first, second = ([row.key for row in result.rows] for result in (old, new))
    return [key for key in first if key not in set(second)], [key for key in second if key not in set(first)]


def comparison_table(old: Result, new: Result) -> str:
    """A Markdown table; a change of time within the noise of the repetitions is marked."""
    lines = ["| row | seconds × | memory × | errors |", "|---|---|---|---|"]
    for row in compare_results(old, new):
        time = "–" if row.seconds is None else f"{row.seconds:.2f}{'' if row.significant else ' (noise)'}"
        memory = "–" if row.memory is None else f"{row.memory:.2f}"
        errors = ", ".join(
            f"{name} {value:+.2f}" if "dB" in name else f"{name} ×{three_digits(value)}"
            for name, value in row.errors.items()
        )
        lines.append(f"| {row.key} | {time} | {memory} | {errors or '–'} |")
    only_old, only_new = unmatched_keys(old, new)
    lines += [f"\nOnly in the first: {'; '.join(only_old)}"] if only_old else []
    lines += [f"\nOnly in the second: {'; '.join(only_new)}"] if only_new else []
    if old.machine.get("processor") != new.machine.get("processor"):
        lines.append(f"\nOn different machines: {old.machine.get('processor')}; {new.machine.get('processor')}.")
    return "\n".join(lines)


def _compare_rows(old: Row, new: Row) -> RowComparison:
    seconds = memory = None
    significant = False
    if old.timing is not None and new.timing is not None:
        a, b = old.timing, new.timing
        seconds = b.median / a.median if a.median > 0 else None
        significant = a.repeats > 1 and b.repeats > 1 and (a.maximum < b.minimum or b.maximum < a.minimum)
        if a.memory_bytes and b.memory_bytes:
            memory = b.memory_bytes / a.memory_bytes
    errors = {
        name: new.errors[name] - value if "dB" in name else new.errors[name] / value
        for name, value in old.errors.items()
        if name in new.errors and ("dB" in name or value != 0)
    }
    return RowComparison(old.key, seconds, significant, memory, errors)
