"""The section on model selection: hypotheses with their margins, refinements with their gains on held-out views."""

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
    """The explanation, the tables of hypotheses and of refinements, and one sentence for each later step.

    `seconds` are the times at which the comparisons ended. The time of a first refinement includes all hypotheses and
    the fit of the model that it is compared with.
    """
    report = report_of(document, "reflectance")
    comparisons = report.get("comparisons") or []
    revision = report.get("revision") or {}
    unchanged = report.get("unchanged_mesh") or {}
    if revision.get("accepted") or unchanged.get("selected"):
        seconds = ()  # of the first mesh, which was replaced
    explanation, hypotheses = report.get("explanation"), report.get("hypotheses") or []
    parts = []
    if explanation:
        text = f"{explanation['sentence']} ({explanation.get('held_out_views') or 0} held-out views)."
        parts.append(notice(text[:1].upper() + text[1:] + _within_noise(explanation, "margin")))
    if hypotheses:
        parts.append(_hypotheses(hypotheses))
    if shape := report.get("shape"):
        sentence = f"Shape from {shape['sentence']} ({shape['held_out_views']} held-out views)."
        parts.append(notice(sentence + _within_noise(shape, "difference")))
    if unchanged:
        sentence = f"In the mesh, {unchanged['sentence']} ({unchanged['held_out_views']} held-out views)."
        parts.append(notice(sentence + _within_noise(unchanged, "difference")))
    if revision.get("changed"):
        sentence = f"Material and light showed another mesh; {revision['sentence']}"
        parts.append(notice(f"{sentence} ({revision['held_out_views']} views)." + _within_noise(revision, "gain")))
    if lamp := report.get("lamp"):
        parts.append(notice(_lamp_sentence(lamp)))
    if exposures := report.get("exposures"):
        parts.append(notice(f"Exposures are {exposures['sentence']}." + _within_noise(exposures, "difference")))
    if scale := report.get("light_scale"):
        parts.append(notice(f"The scale between albedo and light is {scale['sentence']}."))
    if comparisons:
        parts.append(_candidates(comparisons, seconds))
    if not comparisons and not hypotheses and report.get("model"):
        parts.append(notice(f"No models were compared; the settings chose {report['model']}."))
    for key, text in REFINEMENTS.items():
        refinement = report.get(key) or {}
        if refinement.get("gain_db") is not None:
            parts.append(notice(_refinement_sentence(text, refinement)))
    return Markup("").join(parts)


def _hypotheses(hypotheses: Sequence[Document]) -> Markup:
    rounds = max(len(entry["held_out_db"]) for entry in hypotheses)
    rows = []
    for entry in hypotheses:
        curve = list(entry["held_out_db"])
        levels = [Cell(f"{level:.2f}", "number") for level in curve]
        levels += [Cell("–", "number")] * (rounds - len(curve))
        selected = entry.get("margin_db") is None
        margin = f"{number(entry['margin_db'], 2)} ± {number(entry['standard_error_db'], 2)}" if not selected else "–"
        state = "selected" if selected else "dropped" if entry["dropped"] else "rejected"
        rows.append(Row(str(entry["hypothesis"]), (*levels, Cell(margin, "number"), Cell(state)), state))
    headings = ("", *(f"round {i + 1}, dB" for i in range(rounds)), "behind by, dB", "")
    return table("hypotheses", headings, rows)


def _candidates(comparisons: Sequence[Document], seconds: Sequence[float]) -> Markup:
    levels = [entry["held_out_db"] for entry in comparisons]
    low, span = min(levels) - 1, max(max(levels) - min(levels) + 1, 1e-9)
    known = len(seconds) == len(comparisons)
    spent = np.diff(seconds, prepend=0.0).tolist() if known else [None] * len(comparisons)
    rows = []
    for entry, time in zip(comparisons, spent, strict=True):
        gain = f"{number(entry['gain_db'], 2)} ± {number(entry['standard_error_db'], 2)}"
        decision = "accepted" if entry["accepted"] else "rejected"
        cells = (
            Cell(f"{100 * (entry['held_out_db'] - low) / span:.1f}", "bar"),
            Cell(f"{entry['held_out_db']:.2f} dB", "number"),
            Cell(gain, "number"),
            Cell("–" if time is None else duration(time), "number"),
            Cell(f"{decision}, within noise" if entry.get("near_tie") else decision),
        )
        rows.append(Row(str(entry["model"]), cells, decision))
    return table("model_selection", ("", "held-out views", "", "gain, dB", "time", ""), rows)


def _refinement_sentence(text: str, refinement: Document) -> str:
    gain = f"{number(refinement['gain_db'], 2)} ± {number(refinement['standard_error_db'], 2)} dB"
    decision = "accepted" if refinement["accepted"] else "rejected"
    change = f"held-out views {refinement['before_db']:.2f} → {refinement['after_db']:.2f} dB ({gain})"
    sentence = f"{text.format(renderer=refinement['renderer'])}: {change}: {decision}."
    return sentence + _within_noise(refinement, "gain")


def _lamp_sentence(lamp: Document) -> str:
    gain = f"{number(lamp['gain_db'], 1)} ± {number(lamp['standard_error_db'], 1)} dB"
    took_part = "are among the hypotheses" if lamp["took_part"] else "are not among the hypotheses"
    sentence = f"Models with a lamp near the camera {took_part}: a short fit gains {gain} over {lamp['compared_with']}"
    return f"{sentence} ({lamp['held_out_views']} held-out views)." + _within_noise(lamp, "gain")


def _within_noise(decision: Document, of: str) -> str:
    return f" The {of} is within noise." if decision.get("near_tie") else ""
