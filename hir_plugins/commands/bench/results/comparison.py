"""Two result files side by side: ratios of seconds, memory and errors, row by row."""

from __future__ import annotations

from dataclasses import dataclass

from hir_plugins.commands.bench.results.bench_result import Result, Row
from hir_plugins.commands.bench.results.markdown_tables import short


@dataclass(frozen=True)
class Ratio:
    """How the second file's row stands to the first's."""

    key: str
    seconds: float | None
    """Second over first; below 1 is faster."""
    certain: bool
    """Do the ranges of the repeats lie apart?"""
    memory: float | None
    errors: dict[str, float]
    """Second over first; for dB, second minus first."""


def compare(before: Result, after: Result) -> list[Ratio]:
    """Rows that both files have, in the order of the first."""
    others = {row.key: row for row in after.rows}
    return [_ratio(row, others[row.key]) for row in before.rows if row.key in others]


def unmatched(before: Result, after: Result) -> tuple[list[str], list[str]]:
    """Keys that only the first has, and only the second."""
    first, second = ([row.key for row in result.rows] for result in (before, after))
    return [k for k in first if k not in set(second)], [k for k in second if k not in set(first)]


def markdown(before: Result, after: Result) -> str:
    """A table of ratios; a change within the noise of the repeats is marked so."""
    lines = ["| row | seconds × | memory × | errors |", "|---|---|---|---|"]
    for ratio in compare(before, after):
        time = "–" if ratio.seconds is None else f"{ratio.seconds:.2f}{'' if ratio.certain else ' (noise)'}"
        memory = "–" if ratio.memory is None else f"{ratio.memory:.2f}"
        errors = ", ".join(
            f"{name} {value:+.2f}" if "dB" in name else f"{name} ×{short(value)}"
            for name, value in ratio.errors.items()
        )
        lines.append(f"| {ratio.key} | {time} | {memory} | {errors or '–'} |")
    gone, new = unmatched(before, after)
    lines += [f"\nOnly in the first: {'; '.join(gone)}"] if gone else []
    lines += [f"\nOnly in the second: {'; '.join(new)}"] if new else []
    if before.machine.get("processor") != after.machine.get("processor"):
        lines.append(f"\nOn different machines: {before.machine.get('processor')}; {after.machine.get('processor')}.")
    return "\n".join(lines)


def _ratio(before: Row, after: Row) -> Ratio:
    seconds = memory = None
    certain = False
    if before.timing is not None and after.timing is not None:
        a, b = before.timing, after.timing
        seconds = b.median / a.median if a.median > 0 else None
        certain = a.repeats > 1 and b.repeats > 1 and (a.maximum < b.minimum or b.maximum < a.minimum)
        if a.memory_bytes and b.memory_bytes:
            memory = b.memory_bytes / a.memory_bytes
    errors = {
        name: after.errors[name] - value if "dB" in name else after.errors[name] / value
        for name, value in before.errors.items()
        if name in after.errors and ("dB" in name or value != 0)
    }
    return Ratio(before.key, seconds, certain, memory, errors)
