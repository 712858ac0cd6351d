"""Tables and lists of the report, from run.json and timings.json."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from hir_core.report.page_templates import render
from hir_core.report.value_formatting import Document, report_of
from hir_core.run.run_directory import STAGE_NAMES

MAX_FACTS = 8
MAX_FACT_LENGTH = 40
"""Characters; longer values of a stage's report are left out of the table of stages."""


@dataclass(frozen=True)
class Cell:
    """One cell of a table."""

    text: str
    kind: str = ""
    """CSS class; `bar` draws `text`, a number from 0 to 100, as a bar."""


@dataclass(frozen=True)
class Row:
    """One row of a table."""

    heading: str
    cells: Sequence[Cell]
    kind: str = ""
    """CSS class."""


def table(name: str, headings: Sequence[str], rows: Sequence[Row]) -> Markup:
    """A table of the CSS class `name`."""
    return render("table.html", name=name, headings=headings, rows=rows)


def notice(text: str, command: str = "") -> Markup:
    """A sentence in place of a table, and the command that fills the table."""
    return render("notice.html", text=text, command=command)


def stages(document: Document, timings: Document) -> Markup:
    """Time, peak memory and main figures of each stage."""
    entries = timings.get("stages", {})
    longest = max([entry.get("seconds", 0.0) for entry in entries.values()] or [0.0]) or 1.0
    rows = []
    for stage in STAGE_NAMES:
        if stage not in document["stages"]:
            continue
        seconds = float(entries.get(stage, {}).get("seconds", 0.0))
        memory = entries.get(stage, {}).get("peak_memory_bytes", 0) / 2**30
        cells = (
            Cell(f"{seconds:.1f} s", "number"),
            Cell(f"{100 * seconds / longest:.1f}", "bar"),
            Cell(f"{memory:.1f} GiB", "number"),
            Cell(", ".join([*facts(report_of(document, stage)), *spikes(report_of(document, stage))]), "facts"),
        )
        rows.append(Row(stage, cells))
    return table("stages", ("", "time", "", "peak memory", ""), rows)


def facts(report: Document) -> list[str]:
    """Short values of a stage's report, each with its name; at most `MAX_FACTS`."""
    found = []
    for name, value in report.items():
        if isinstance(value, bool | str) or value is None:
            text = str(value)
        elif isinstance(value, int):
            text = f"{value:,}"
        elif isinstance(value, float):
            text = f"{value:.4g}"
        else:
            continue
        if len(text) <= MAX_FACT_LENGTH:
            found.append(f"{name.replace('_', ' ')} {text}")
    return found[:MAX_FACTS]


def spikes(report: Document) -> list[str]:
    """Largest dihedral angle and longest edge of the mesh that a stage made, where its report has them."""
    mesh = report.get("mesh", {})
    state = mesh.get("after", {}) if isinstance(mesh, dict) else {}
    if not {"largest_dihedral_deg", "longest_edge_ratio"} <= set(state):
        return []
    dihedral, edge = state["largest_dihedral_deg"], state["longest_edge_ratio"]
    return [f"largest dihedral angle {dihedral:.0f}°", f"longest edge {edge:.1f} median edges"]


def exports(document: Document) -> Markup:
    """What reading back and rendering measured of each exported file."""
    rows = []
    for name, report in report_of(document, "export").items():
        verified = report.get("verified", {})
        if "psnr" in verified:
            result = f"{verified['psnr']['object']:.1f} dB"
        else:
            result = str(verified.get("not_rendered") or verified.get("not_read") or "read back")
        brdf = f"{verified['brdf']:.1%}" if "brdf" in verified else "–"
        cells = (Cell(brdf, "number"), Cell(result, "number"), Cell(str(verified.get("rendered", ""))))
        rows.append(Row(name, cells))
    if not rows:
        return notice("No file is exported yet", "hir export RUN")
    return table("evaluations", ("", "material error", "render against fit", "interpreted as"), rows)


def warnings(document: Document) -> Markup:
    """The warnings of all stages and the problems of plugins."""
    found = [(stage, w) for stage in STAGE_NAMES for w in document["stages"].get(stage, {}).get("warnings", ())]
    found += [("plugin", problem) for problem in document.get("plugin_problems", ())]
    return render("warnings.html", warnings=found) if found else notice("No warnings.")


def details(title: str, content: object) -> Markup:
    """A document as JSON, folded."""
    return render("details.html", title=title, text=json.dumps(content, indent=1, ensure_ascii=False))
