"""docs/stability.md from the cases."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import numpy as np

from tests.stability.case import Case, Outcome, examine

MODULES = ("brdf", "color", "light", "lens", "mesh", "tangents", "silhouettes", "surface", "fitting")
PAGE = Path(__file__).resolve().parents[2] / "docs" / "stability.md"


TITLES = {
    "initialization": "Initialization: cameras, files, first colours",
    "geometry": "Geometry: meshes, silhouettes, steps",
    "reflectance": "Reflectance: BRDF, light, textures",
    "export": "Export: codes, materials, tangents",
}

INTRODUCTION = """# Hard cases

Inputs at the ends of their range, where the formula of a textbook gives NaN, an infinity, or a wrong number. Each row
calls the function named, compares it with the same value in 60 digits (mpmath) or in closed form, and runs the naive
formula on the same numbers; a row stands here only where the naive one fails. `make stability` computes this page, and
every row is a test (`tests/stability`).

The error is the largest difference over the largest true value (over 1 where the truth is 0). *Not finite*: NaN,
infinite, or an exception.
"""


def all_cases() -> list[Case]:
    """Every case, in the order of the page."""
    return [case for name in MODULES for case in import_module(f"tests.stability.cases_{name}").CASES]


def page() -> str:
    """The whole page."""
    cases = all_cases()
    parts = [INTRODUCTION, f"{len(cases)} cases; none of hir's results is off by more than its row's tolerance.\n"]
    for area, title in TITLES.items():
        rows = [case for case in cases if case.area == area]
        parts.append(f"## {title}\n\n{len(rows)} cases.\n")
        parts.append("| function | input | expected | result | reference | error | naive formula | naive result |")
        parts.append("|---|---|---|---|---|---|---|---|")
        parts += [_row(case, examine(case)) for case in rows]
        parts.append("")
    return "\n".join(parts)


def _row(case: Case, found: Outcome) -> str:
    naive = "not finite" if found.naive is None or not np.isfinite(found.naive).all() else _number(found.naive)
    formula = case.shown.replace("|", "\\|")
    name = case.function.partition(".")[2]
    cells = [
        f"`{name}`",
        case.input_text,
        case.expected,
        _number(found.result),
        _number(found.truth),
        f"{found.error:.1g}",
        f"`{formula}`",
        naive,
    ]
    return "| " + " | ".join(cells) + " |"


def _number(value: np.ndarray) -> str:
    """One number, or a few; of more the first and how many."""
    flat = value.ravel()
    shown = ", ".join(f"{v:.8g}" for v in flat[:3])
    return shown if flat.size <= 3 else f"{shown}, … ({flat.size})"


def main() -> None:
    """Writes the page and says what is in it."""
    text = page()
    PAGE.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
