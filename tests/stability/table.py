"""docs/stability.md from the cases."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

import numpy as np

from tests.stability.case import Case, examine

MODULES = ("brdf", "color", "light", "lens", "mesh", "tangents", "silhouettes", "surface", "fitting", "literature")
PAGE = Path(__file__).resolve().parents[2] / "docs" / "stability.md"


TITLES = {
    "initialization": "Initialization: cameras, files, first colours",
    "geometry": "Geometry: meshes, silhouettes, steps",
    "reflectance": "Reflectance: BRDF, light, textures",
    "export": "Export: quantization, materials, tangents",
}

INTRODUCTION = """# Numerical edge cases

Inputs at the limits of their range, where a textbook formula gives NaN, infinity, or a wrong number. Each row calls the
named function, compares the result with the value in 60 digits (mpmath) or in closed form, and evaluates the naive
formula on the same numbers, in float32 (shown) and in float64. An input is listed only where the naive formula fails in
both. Inputs of one function and one naive formula share a row, which shows the input with the largest error of hir and
says how many others there are. `make stability` writes this page, and every input is a test (`tests/stability`).

The error is the largest difference over the largest true value (over 1 where the truth is 0). A few roundings of
float64, up to 2·10⁻¹⁵, are shown as 0: they differ between processors. *Not finite*: NaN, infinite, or an exception.
"""

FEW_ROUNDINGS = 2e-15


def all_cases() -> list[Case]:
    """Every case, in the order of the page."""
    return [case for name in MODULES for case in import_module(f"tests.stability.cases_{name}").CASES]


def rows_of(cases: Sequence[Case]) -> list[list[Case]]:
    """The cases that share a row: those of one area, one function and one naive formula."""
    rows: dict[tuple[str, str, str], list[Case]] = {}
    for case in cases:
        rows.setdefault((case.area, case.function, case.shown), []).append(case)
    return list(rows.values())


def page() -> str:
    """The text of the page."""
    cases = all_cases()
    count = f"{len(rows_of(cases))} formulas with {len(cases)} inputs"
    parts = [INTRODUCTION, f"{count}; every result of hir is within the tolerance of its case.\n"]
    for area, title in TITLES.items():
        inputs = [case for case in cases if case.area == area]
        rows = rows_of(inputs)
        parts.append(f"## {title}\n\n{len(rows)} formulas, {len(inputs)} inputs.\n")
        parts.append("| function | input | expected | result | reference | error | naive formula | naive result |")
        parts.append("|---|---|---|---|---|---|---|---|")
        parts += [_row(row) for row in rows]
        parts.append("")
    return "\n".join(parts)


def _row(cases: Sequence[Case]) -> str:
    """Of the case with the largest error; errors below `FEW_ROUNDINGS` differ between processors and count as equal."""
    outcomes = [(case, examine(case)) for case in cases]
    case, found = max(outcomes, key=lambda each: max(each[1].error, FEW_ROUNDINGS))
    others = f" (and {len(cases) - 1} more)" if len(cases) > 1 else ""
    naive = "not finite" if found.naive is None or not np.isfinite(found.naive).all() else _number(found.naive)
    formula = case.shown.replace("|", "\\|")
    name = case.function.partition(".")[2]
    cells = [
        f"`{name}`",
        case.input_text + others,
        case.expected,
        _number(np.where((found.truth == 0) & (np.abs(found.result) < FEW_ROUNDINGS), 0, found.result)),
        _number(found.truth),
        f"{found.error if found.error >= FEW_ROUNDINGS else 0:.1g}",
        f"`{formula}`",
        naive,
    ]
    return "| " + " | ".join(cells) + " |"


def _number(value: np.ndarray) -> str:
    """Up to three numbers; of more values the first three and their count."""
    flat = value.ravel()
    shown = ", ".join(f"{v:.8g}" for v in flat[:3])
    return shown if flat.size <= 3 else f"{shown}, … ({flat.size})"


def main(arguments: Sequence[str] | None = None) -> None:
    """Writes and prints the page."""
    parser = argparse.ArgumentParser(prog="python -m tests.stability.table", description="Writes docs/stability.md.")
    parser.parse_args(arguments)
    text = page()
    PAGE.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
