"""The materials benchmark against its bar, for each half; the variation over seeds."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from hir_plugins.commands.bench.results.bench_result import Row

SELECTED: Final = "selected"
"""Method of the rows of runs that select by themselves."""
UNSEEN: Final = "unseen dB, object"
RELIT: Final = "relit scaled dB, frame"
REGRET: Final = "regret dB"
OUTSIDE: Final = "outside the model"
WITHIN_NOISE: Final = "within noise"
NOT_RENDERED: Final = "not rendered"


@dataclass(frozen=True)
class Bar:
    """One figure that the benchmark is held to."""

    name: str
    goal: str
    measure: Callable[[Sequence[Row]], float | None]
    """None where no row has what it needs."""
    unit: str
    least: float

    def text(self, rows: Sequence[Row]) -> str:
        """The figure, and whether it reaches the goal."""
        value = self.measure(rows)
        if value is None:
            return "–"
        shown = f"{100 * value:.0f} %" if self.unit == "%" else f"{value:.1f} dB"
        return f"{shown} {'✓' if value >= self.least else '✗'}"


def share(values: Iterable[bool]) -> float | None:
    """Share of true ones; None of none."""
    found = list(values)
    return sum(found) / len(found) if found else None


def median_of(name: str) -> Callable[[Sequence[Row]], float | None]:
    """The median of an error over rows that have it."""

    def measure(rows: Sequence[Row]) -> float | None:
        found = [row.errors[name] for row in rows if name in row.errors]
        return statistics.median(found) if found else None

    return measure


def is_right_kind(row: Row) -> bool:
    """A diffuse model of a dielectric is right: its highlight may be too weak to be seen."""
    found = "dielectric" if row.labels["kind"] == "diffuse" else row.labels["kind"]
    return found == row.labels["true kind"].partition(",")[0]


REGRET_DB: Final = 0.3
BARS: Final = (
    Bar(
        "right light frame",
        "≥ 95 %",
        lambda rows: share(row.labels["light"] == row.labels["true light"] for row in rows),
        "%",
        0.95,
    ),
    Bar(
        "right kind, margin not within noise",
        "≥ 90 %",
        lambda rows: share(is_right_kind(row) for row in rows if row.labels["margin"] != WITHIN_NOISE),
        "%",
        0.9,
    ),
    Bar(
        f"regret at most {REGRET_DB} dB",
        "≥ 95 %",
        lambda rows: share(row.errors[REGRET] <= REGRET_DB for row in rows if REGRET in row.errors),
        "%",
        0.95,
    ),
    Bar("median unseen, object", "≥ 34 dB", median_of(UNSEEN), "dB", 34.0),
    Bar("median relit (scaled), frame", "≥ 32 dB", median_of(RELIT), "dB", 32.0),
)


def materials_summary(rows: Sequence[Row]) -> str:
    """A table of the bar for each half and mesh; below it the variation over seeds, and what is missing."""
    selected = [row for row in rows if row.method == SELECTED and row.timing is not None]
    groups = dict.fromkeys((str(row.case["half"]), str(row.case["mesh"])) for row in selected)
    heads = ["half", "mesh", "captures", *(f"{bar.name} (goal {bar.goal})" for bar in BARS)]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for half, mesh in groups:
        every = [row for row in selected if (row.case["half"], row.case["mesh"]) == (half, mesh)]
        inside = [row for row in every if OUTSIDE not in row.labels["true kind"]]
        for name, part in (("all", every), ("within the model", inside)):
            captures = len({row.case["capture"] for row in part})
            lines.append(
                "| " + " | ".join([half, mesh, f"{captures} {name}", *(bar.text(part) for bar in BARS)]) + " |"
            )
    text = ["\n".join(lines)]
    variation = seed_variation_table(selected)
    text += [variation] if variation else []
    missing = [str(row.case["capture"]) for row in rows if row.note == NOT_RENDERED]
    if missing:
        text.append(f"{len(missing)} captures are not rendered: {', '.join(missing)}.")
    return "\n\n".join(text)


def seed_variation_table(rows: Sequence[Row], error: str = UNSEEN) -> str:
    """Mean and standard deviation of `error` over seeds, for captures that have several; empty without any."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((str(row.case["capture"]), str(row.case["mesh"])), []).append(row)
    several = {key: found for key, found in groups.items() if len(found) > 1}
    if not several:
        return ""
    lines = ["| capture | mesh | seeds | mean dB | standard deviation | models |", "|---|---|---|---|---|---|"]
    for (capture, mesh), found in several.items():
        values = [row.errors[error] for row in found]
        models = "; ".join(dict.fromkeys(row.labels["model"] for row in found))
        mean, deviation = statistics.mean(values), statistics.stdev(values)
        lines.append(f"| {capture} | {mesh} | {len(values)} | {mean:.2f} | {deviation:.2f} | {models} |")
    return "\n".join(lines)
