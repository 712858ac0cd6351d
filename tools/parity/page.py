"""Writes docs/engines/parity.md: the table and one sheet of pictures for each object.

Figures are stored in parity.json beside the page. Engines and objects that a call does not render keep their stored
figures.
"""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

_TEXT = Path(__file__).with_name("parity.template.md")
_ORDER = ("spot", "avocado", "spot_model", "avocado_model", "metal", "mixed")
_OTHER_PIXELS = (
    "Some figures over the object are of an earlier run (`pixels` in parity.json is not `covered`): they count all "
    "pixels that are not black, a few of the outline more."
)
_TILE = 192
_CHARACTERS_PER_LINE = 18
"""Characters of a line beside a row of pictures."""


@dataclass(frozen=True)
class Row:
    """The result of one engine for one object."""

    subject: str
    engine: str
    file: str
    pictures: list[NDArray[np.float32]]
    frame: float | None
    """dB over the frame, mean of the sides; None for our own renderer and for engines that gave no picture."""
    inside: float | None
    """dB over the object's pixels."""
    note: str

    def sentence(self) -> str:
        """One line of the log."""
        if self.frame is None or self.inside is None:
            return f"{self.engine} {self.file} {self.note}"
        return f"{self.engine} {self.file}: {self.frame:.1f} / {self.inside:.1f} dB"


def write_page(folder: Path, rows: list[Row], size: int, samples: int) -> None:
    """parity.md from its template, and images/parity_SUBJECT.jpg beside it."""
    (folder / "images").mkdir(parents=True, exist_ok=True)
    stored = _merged(folder / "parity.json", rows)
    rendered_subjects = list(dict.fromkeys(row.subject for row in rows))
    subjects = sorted({str(entry["subject"]) for entry in stored} | set(rendered_subjects), key=_position)
    kinds = sorted({(str(entry["engine"]), str(entry["file"])) for entry in stored})
    table = ["| engine | file | " + " | ".join(subjects) + " |", "|---|---|" + "---|" * len(subjects)]
    for engine, file in kinds:
        cells = [
            _cell(next((e for e in stored if (e["subject"], e["engine"], e["file"]) == (s, engine, file)), None))
            for s in subjects
        ]
        table.append(f"| {engine} | `{file}` | " + " | ".join(cells) + " |")
    notes = ["- " + _OTHER_PIXELS] if any(entry["pixels"] != "covered" for entry in stored) else []
    notes.append("- " + _dates(stored))
    notes += [f"- {r.engine}, `{r.file}`, {r.subject}: {r.note}" for r in rows if r.note]
    pictures = []
    for subject in subjects:
        if subject in rendered_subjects:  # else its sheet of an earlier call
            rendered = [row for row in rows if row.subject == subject and row.pictures]
            _sheet(rendered).save(folder / "images" / f"parity_{subject}.jpg", quality=88)
        engines = ", ".join(f"{e['engine']} {e['file']}" for e in stored if e["subject"] == subject)
        pictures.append(f"![{subject}: hir, {engines}](images/parity_{subject}.jpg)")
    sources = {str(entry["subject"]): str(entry["origin"]) for entry in stored}
    arguments = {
        "a run": "a whole run of `hir reconstruct`",
        "a model": "the model that the capture was rendered from, under a studio light",
    }
    origins = "; ".join(f"{name} is {arguments[how]}" for name, how in sources.items() if how in arguments)
    fields = {
        "origins": origins or "no captured object was selected",
        "table": "\n".join(table),
        "notes": "\n".join(notes),
        "pictures": "\n\n".join(pictures),
        "size": str(size),
        "samples": str(samples),
    }
    text = _TEXT.read_text(encoding="utf-8")
    for name, value in fields.items():
        text = text.replace(f"<!--{name}-->", value)
    (folder / "parity.md").write_text(text.rstrip() + "\n", encoding="utf-8")


def _merged(file: Path, rows: list[Row]) -> list[dict[str, str | float]]:
    """The stored figures with those of `rows` in their place; they are written back."""
    stored = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else []
    found = {(entry["subject"], entry["engine"], entry["file"]): entry for entry in stored}
    origins = {row.subject: row.engine.rpartition(", ")[2] for row in rows if row.frame is None and row.pictures}
    for row in rows:
        if row.frame is not None and row.inside is not None:
            found[row.subject, row.engine, row.file] = {
                "subject": row.subject,
                "engine": row.engine,
                "file": row.file,
                "frame": round(row.frame, 4),
                "inside": round(row.inside, 4),
                "origin": origins[row.subject],
                "pixels": "covered",
                "date": date.today().isoformat(),
            }
    entries = [found[key] for key in sorted(found)]
    file.write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")
    return entries


def _dates(stored: Sequence[Mapping[str, str | float]]) -> str:
    """When the figures were measured, for each object and engine where days differ."""
    first = str(stored[0]["date"])
    if all(entry["date"] == first for entry in stored):
        return f"All figures were measured on {first}."
    days: dict[str, dict[str, list[str]]] = {}
    for entry in stored:
        engine = f"{str(entry['engine']).split()[0]} `{entry['file']}`"
        days.setdefault(str(entry["date"]), {}).setdefault(str(entry["subject"]), []).append(engine)
    said = [
        f"{day}: " + "; ".join(f"{subject} in {', '.join(engines)}" for subject, engines in subjects.items())
        for day, subjects in sorted(days.items())
    ]
    return "Measured on " + ". On ".join(said) + "."


def _position(subject: str) -> tuple[int, str]:
    return (_ORDER.index(subject) if subject in _ORDER else len(_ORDER), subject)


def _cell(entry: Mapping[str, str | float] | None) -> str:
    return "– (not run)" if entry is None else f"{entry['frame']:.1f} / {entry['inside']:.1f}"


def _sheet(rows: list[Row]) -> Image.Image:
    """One row of pictures for each engine, its name on the left."""
    width, margin = max(len(row.pictures) for row in rows), 150
    sheet = Image.new("RGB", (margin + width * _TILE, len(rows) * _TILE), (20, 21, 24))
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(13)
    for index, row in enumerate(rows):
        lines = [*textwrap.wrap(row.engine, _CHARACTERS_PER_LINE), row.file]
        if row.frame is not None:
            lines.append(f"{row.frame:.1f} / {row.inside:.1f} dB")
        draw.multiline_text((10, index * _TILE + 60), "\n".join(line for line in lines if line), (225, 224, 220), font)
        for column, picture in enumerate(row.pictures):
            codes = np.rint(np.clip(picture, 0, 1) * 255).astype(np.uint8)
            tile = Image.fromarray(codes).resize((_TILE, _TILE), Image.Resampling.BOX)
            sheet.paste(tile, (margin + column * _TILE, index * _TILE))
    return sheet
