"""batch.html: the captures of a batch with thumbnail, figures and warnings, worst first, in one HTML file."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.resources import files
from statistics import median
from typing import Any, Final
from urllib.parse import quote

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from hir_core import __version__
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.layout import Destination

MAX_ROWS: Final = 2000
"""The captures that the page displays, the worst ones; batch.json contains all."""

STATE_ORDER: Final = {"failed": 0, "done": 1, "running": 2, "waiting": 3}

Entry = Mapping[str, Any]
"""A capture in batch.json."""


@dataclass(frozen=True)
class PageRow:
    """One capture in the page's table; None where a figure is unknown."""

    name: str
    state: str
    source: str
    reason: str
    psnr_object: float | None
    psnr_frame: float | None
    seconds: float | None
    retries: int
    warnings: Sequence[str]
    thumbnail: str

    @property
    def state_order(self) -> int:
        return STATE_ORDER.get(self.state, max(STATE_ORDER.values()))

    @property
    def url_name(self) -> str:
        return quote(self.name)


def write_page(destination: Destination, entries: Mapping[str, Entry], updated: str, max_rows: int = MAX_ROWS) -> None:
    """Writes batch.html for the entries of a manifest, with the thumbnails of the displayed captures."""
    names = sorted(entries, key=lambda name: worst_first(name, entries[name]))[:max_rows]
    with ThreadPoolExecutor(object_store.MAX_PARALLEL_TRANSFERS) as pool:
        done = [name for name in names if entries[name]["state"] == "done"]
        thumbnails = dict(zip(done, pool.map(lambda name: _thumbnail(destination, name), done), strict=True))
    page = render_page(destination.root.name, entries, names, thumbnails, updated)
    object_store.write(destination.page, page.encode())


def worst_first(name: str, entry: Entry) -> tuple[int, float, str]:
    """A sorting key: failed captures, then finished ones by PSNR, then unfinished ones."""
    psnr = psnr_of(entry, "object")
    return STATE_ORDER.get(entry["state"], 3), float("-inf") if psnr is None else psnr, name


def psnr_of(entry: Entry, key: str) -> float | None:
    """PSNR in dB over the object's pixels (`object`) or the whole frame (`frame`); None if it is unknown."""
    value = (entry.get("psnr") or {}).get(key)
    return float(value) if isinstance(value, int | float) else None


def seconds_of(entry: Entry) -> float | None:
    """The sum over all stages; None if it is unknown."""
    stage_seconds = entry.get("stage_seconds")
    return float(sum(stage_seconds.values())) if stage_seconds else None


def render_page(
    title: str, entries: Mapping[str, Entry], names: Sequence[str], thumbnails: Mapping[str, str], updated: str
) -> str:
    """The page's HTML; `names` are the rows in order."""
    report, own = files("hir_core.report") / "template", files("hir_plugins.commands.batch.summary") / "template"
    # our own style sheets and script are the only text that is not escaped
    css = "".join((folder / "page.css").read_text(encoding="utf-8") for folder in (report, own))
    script = (own / "page.js").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    template = environment.from_string((own / "page.html").read_text(encoding="utf-8"))
    return template.render(
        css=Markup(css),
        script=Markup(script),
        title=title,
        captures=len(entries),
        tiles=_tiles(entries),
        omitted=len(entries) - len(names),
        version=__version__,
        updated=updated,
        rows=[_row(name, entries[name], thumbnails.get(name, "")) for name in names],
    )


def _tiles(entries: Mapping[str, Entry]) -> list[tuple[str, str]]:
    """Value and label of each figure at the top of the page."""
    states = [entry["state"] for entry in entries.values()]
    done, failed = states.count("done"), states.count("failed")
    psnr = [value for entry in entries.values() if (value := psnr_of(entry, "object")) is not None]
    hours = sum(seconds_of(entry) or 0.0 for entry in entries.values()) / 3600
    return [
        (f"{done:,}", "done"),
        (f"{failed:,}", "failed"),
        (f"{len(states) - done - failed:,}", "not finished"),
        (f"{median(psnr):.1f} dB" if psnr else "–", "median PSNR, object"),
        (f"{hours:,.1f} h" if hours >= 1 else f"{60 * hours:.1f} min", "in all stages"),
        (f"{sum(bool(entry.get('warnings')) for entry in entries.values()):,}", "with warnings"),
    ]


def _row(name: str, entry: Entry, thumbnail: str) -> PageRow:
    return PageRow(
        name=name,
        state=str(entry["state"]),
        source=str(entry.get("source", "")),
        reason=str(entry.get("reason", "")),
        psnr_object=psnr_of(entry, "object"),
        psnr_frame=psnr_of(entry, "frame"),
        seconds=seconds_of(entry),
        retries=int(entry.get("retries") or 0),
        warnings=[str(warning) for warning in entry.get("warnings") or ()],
        thumbnail=thumbnail,
    )


def _thumbnail(destination: Destination, name: str) -> str:
    """The thumbnail of a capture's record, if it is a data: URL of a JPEG."""
    url = str(destination.record(name).get("thumbnail", ""))
    return url if re.fullmatch(r"data:image/jpeg;base64,[A-Za-z0-9+/=]+", url) else ""
