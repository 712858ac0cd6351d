"""Results as Markdown tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final

from hir_plugins.commands.bench.results.bench_result import Result, Row, Timing, error_names, group_by_case_names
from hir_plugins.commands.bench.results.materials_summary import materials_summary

PROGRAMS: Final = ("hir", "python", "torch", "mitsuba", "open3d", "numpy")
"""Whose versions are printed."""

SUMMARIES: Final[Mapping[str, Callable[[Sequence[Row]], str]]] = {"materials": materials_summary}
"""Suites whose rows are also judged together."""


def result_markdown(result: Result) -> str:
    """One table for each kind of case, the suite's summary if it has one, and a line about the machine."""
    tables = map(rows_table, group_by_case_names(result.rows) or [[]])
    summary = [SUMMARIES[result.suite](result.rows)] if result.suite in SUMMARIES else []
    return "\n\n".join([*tables, *summary, machine_line(result)]) + "\n"


def rows_table(rows: Sequence[Row]) -> str:
    """Columns for the case, the method, labels, time, memory and errors; a dash if a figure is missing."""
    if not rows:
        return "No rows."
    names = list(dict.fromkeys(name for row in rows for name in row.case))
    errors = error_names(rows)
    labels = list(dict.fromkeys(name for row in rows for name in row.labels))
    has_notes = any(row.note for row in rows)
    notes = ["note"] if has_notes else []
    heads = [*names, "method", *labels, "seconds, min / median / max", "CPU s", "memory", *errors, *notes]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for row in rows:
        cells = [*(case_text(row.case.get(name)) for name in names), method_label(row)]
        cells += [row.labels.get(name) or "–" for name in labels]
        cells += [seconds_text(row.timing), cpu_text(row.timing), memory_text(row.timing)]
        cells += [error_text(row.errors.get(name), name) for name in errors]
        lines.append("| " + " | ".join([*cells, *([row.note] if has_notes else [])]) + " |")
    return "\n".join(lines)


def machine_line(result: Result) -> str:
    """Machine, threads, versions and date in one sentence."""
    machine = result.machine
    programs = ", ".join(f"{name} {result.versions[name]}" for name in PROGRAMS if name in result.versions)
    threads = f", {machine['threads']} of them used" if machine.get("threads") else ""
    made = f"{result.date}, commit {result.commit[:10]}" if result.commit else result.date
    return f"{machine.get('processor')}, {machine.get('cores')} cores{threads}, no GPU used; {programs}; {made}."


def method_label(row: Row) -> str:
    """The method, followed by its role if it is not one of our components."""
    return row.method if row.role == "ours" else f"{row.method} ({row.role})"


def seconds_text(timing: Timing | None) -> str:
    """Minimum, median and maximum, or the only value."""
    if timing is None:
        return "–"
    if timing.repeats == 1:
        return three_digits(timing.median)
    return " / ".join(three_digits(value) for value in (timing.minimum, timing.median, timing.maximum))


def three_digits(value: float) -> str:
    """Three significant digits, without an exponent for values above 100."""
    return f"{value:.3g}" if value < 100 else f"{value:.0f}"


def cpu_text(timing: Timing | None) -> str:
    return "–" if timing is None else three_digits(timing.cpu)


def memory_text(timing: Timing | None) -> str:
    """In MiB or GiB."""
    if timing is None or timing.memory_bytes is None:
        return "–"
    mebibytes = timing.memory_bytes / 2**20
    return f"{mebibytes / 1024:.1f} GiB" if mebibytes >= 1000 else f"{mebibytes:.0f} MiB"


def error_text(value: float | None, name: str) -> str:
    """Two decimals for dB, two significant digits for other errors."""
    if value is None:
        return "–"
    return f"{value:.2f}" if "dB" in name else f"{value:.2g}"


def case_text(value: str | int | float | None) -> str:
    """Integers with thousands separators."""
    return "–" if value is None else f"{value:,}" if isinstance(value, int) else str(value)
