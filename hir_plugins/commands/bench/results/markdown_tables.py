"""Results as Markdown: seconds as min / median / max, memory, every error."""

from __future__ import annotations

from collections.abc import Sequence

from hir_plugins.commands.bench.results.bench_result import Result, Row, Timing, error_names, kinds


def markdown(result: Result) -> str:
    """A table of the rows of each kind of case, and a line that says what they were taken on."""
    return "\n\n".join([*map(table, kinds(result.rows) or [[]]), origin(result)]) + "\n"


def table(rows: Sequence[Row]) -> str:
    """Columns of the case, the method, time, memory and errors; a dash where a figure is missing."""
    if not rows:
        return "No rows."
    names = list(dict.fromkeys(name for row in rows for name in row.case))
    errors = error_names(rows)
    notes = any(row.note for row in rows)
    heads = [*names, "method", "seconds, min / median / max", "CPU s", "memory", *errors, *(["note"] if notes else [])]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for row in rows:
        cells = [*(number(row.case.get(name)) for name in names), labelled(row), seconds(row.timing), cpu(row.timing)]
        cells += [memory(row.timing), *(error(row.errors.get(name), name) for name in errors)]
        lines.append("| " + " | ".join([*cells, *([row.note] if notes else [])]) + " |")
    return "\n".join(lines)


def origin(result: Result) -> str:
    """Machine, threads, versions and day in one sentence."""
    machine = result.machine
    kept = ("hir", "python", "torch", "mitsuba", "open3d", "numpy")
    programs = ", ".join(f"{name} {result.versions[name]}" for name in kept if name in result.versions)
    threads = f", {machine['threads']} of them used" if machine.get("threads") else ""
    return f"{machine.get('processor')}, {machine.get('cores')} cores{threads}, no GPU used; {programs}; {result.date}."


def labelled(row: Row) -> str:
    """The method, marked where it is not a component of ours."""
    return row.method if row.role == "ours" else f"{row.method} ({row.role})"


def seconds(timing: Timing | None) -> str:
    """Of repeats, or the one figure there is."""
    if timing is None:
        return "–"
    if timing.repeats == 1:
        return short(timing.median)
    return " / ".join(short(value) for value in (timing.minimum, timing.median, timing.maximum))


def short(value: float) -> str:
    """Seconds with three digits."""
    return f"{value:.3g}" if value < 100 else f"{value:.0f}"


def cpu(timing: Timing | None) -> str:
    return "–" if timing is None else short(timing.cpu)


def memory(timing: Timing | None) -> str:
    """In MiB or GiB."""
    if timing is None or timing.memory_bytes is None:
        return "–"
    mebibytes = timing.memory_bytes / 2**20
    return f"{mebibytes / 1024:.1f} GiB" if mebibytes >= 1000 else f"{mebibytes:.0f} MiB"


def error(value: float | None, name: str) -> str:
    """Two digits after the point for dB, three that count for the rest."""
    if value is None:
        return "–"
    return f"{value:.2f}" if "dB" in name else f"{value:.2g}"


def number(value: str | int | float | None) -> str:
    """Thousands apart."""
    return "–" if value is None else f"{value:,}" if isinstance(value, int) else str(value)
