"""The section on model selection: every candidate, its gain on held-out views, and the refinements after it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from hir_core.report.tables import Cell, Row, notice, table
from hir_core.report.value_formatting import Document, duration, number, report_of

REFINEMENTS = {
    "albedo_refinement": "Albedo, solved again with renders by {renderer}",
    "path_tracing": "All maps and the light, refined by gradients of {renderer}",
}
"""Steps after the model selection, by their key in the report of the reflectance stage."""


def model_selection(document: Document, seconds: Sequence[float]) -> Markup:
    """The table of candidates and one sentence for each refinement.

    `seconds` are the times at which the comparisons ended. The time of a first candidate includes the fit of the model
    that it is compared with.
    """
    report = report_of(document, "reflectance")
    comparisons = report.get("comparisons") or []
    parts = [_candidates(comparisons, seconds)] if comparisons else []
    if not comparisons and report.get("model"):
        parts.append(notice(f"No models were compared; the settings chose {report['model']}."))
    for key, text in REFINEMENTS.items():
        refinement = report.get(key) or {}
        if refinement.get("gain_db") is not None:
            parts.append(notice(_refinement_sentence(text, refinement)))
    return Markup("").join(parts)


def _candidates(comparisons: Sequence[Document], seconds: Sequence[float]) -> Markup:
    levels = [entry["held_out_db"] for entry in comparisons]
    low, span = min(levels) - 1, max(max(levels) - min(levels) + 1, 1e-9)
    known = len(seconds) == len(comparisons)
    spent = np.diff(seconds, prepend=0.0).tolist() if known else [None] * len(comparisons)
    rows = []
    for i, (entry, time) in enumerate(zip(comparisons, spent, strict=True)):
        gain = f"{number(entry['gain_db'], 2)} ± {number(entry['standard_error_db'], 2)}"
        decision = "accepted" if entry["accepted"] else "rejected"
        cells = (
            Cell(f"{100 * (entry['held_out_db'] - low) / span:.1f}", "bar"),
            Cell(f"{entry['held_out_db']:.2f} dB", "number"),
            Cell("first model" if i == 0 else gain, "number"),
            Cell("–" if time is None else duration(time), "number"),
            Cell(decision),
        )
        rows.append(Row(str(entry["model"]), cells, decision))
    return table("model_selection", ("", "held-out views", "", "gain, dB", "time", ""), rows)


def _refinement_sentence(text: str, refinement: Document) -> str:
    gain = f"{number(refinement['gain_db'], 2)} ± {number(refinement['standard_error_db'], 2)} dB"
    decision = "accepted" if refinement["accepted"] else "rejected"
    change = f"held-out views {refinement['before_db']:.2f} → {refinement['after_db']:.2f} dB ({gain})"
    return f"{text.format(renderer=refinement['renderer'])}: {change}: {decision}."
