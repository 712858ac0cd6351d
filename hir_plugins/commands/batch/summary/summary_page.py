"""batch.html: every capture of a batch with its picture, figures and warnings, worst first; one file to send."""

from __future__ import annotations

import html
import re
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from importlib.resources import files
from statistics import median
from typing import Any, Final
from urllib.parse import quote

from hir_core import __version__
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.layout import Destination

MOST_ROWS: Final = 2000
"""The worst captures that the page shows; batch.json has all."""

RANKS: Final = {"failed": 0, "done": 1, "running": 2, "waiting": 3}


def write_page(destination: Destination, captures: Mapping[str, Mapping[str, Any]], updated: str) -> None:
    """Writes the page of a manifest's entries, with the thumbnails of the captures it shows."""
    names = sorted(captures, key=lambda name: badness(name, captures[name]))[:MOST_ROWS]
    with ThreadPoolExecutor(object_store.AT_ONCE) as pool:
        done = [name for name in names if captures[name]["state"] == "done"]
        thumbnails = dict(zip(done, pool.map(lambda name: _thumbnail(destination, name), done), strict=True))
    object_store.write(destination.page, page(destination.root.name, captures, names, thumbnails, updated).encode())


def badness(name: str, entry: Mapping[str, Any]) -> tuple[int, float, str]:
    """Sorts the worst first: failed ones, then by PSNR, then what is not finished yet."""
    psnr = figure(entry, "object")
    return RANKS.get(entry["state"], 3), float("-inf") if psnr is None else psnr, name


def figure(entry: Mapping[str, Any], key: str) -> float | None:
    """PSNR in dB over the object's pixels or the whole frame; None where there is none."""
    value = (entry.get("psnr") or {}).get(key)
    return float(value) if isinstance(value, int | float) else None


def seconds_of(entry: Mapping[str, Any]) -> float | None:
    """Of all stages together; None where none is known."""
    found = entry.get("stage_seconds")
    return float(sum(found.values())) if found else None


def page(
    title: str, captures: Mapping[str, Mapping[str, Any]], names: list[str], thumbnails: Mapping[str, str], updated: str
) -> str:
    """The page's text; `names` are the rows, in their order."""
    report, own = files("hir_core.report") / "template", files("hir_plugins.commands.batch.summary") / "template"
    left_out = len(captures) - len(names)
    parts = {
        "css": "".join((folder / "page.css").read_text(encoding="utf-8") for folder in (report, own)),
        "js": (own / "page.js").read_text(encoding="utf-8"),
        "title": html.escape(title),
        "lead": f"{len(captures):,} captures, worst first.",
        "tiles": _tiles(captures),
        "left-out": f"{left_out:,} better ones are not shown; batch.json has all." if left_out else "",
        "version": __version__,
        "updated": html.escape(updated),
        "rows": "".join(_row(name, captures[name], thumbnails.get(name, "")) for name in names),
    }
    text = (own / "page.html").read_text(encoding="utf-8")
    for name, part in parts.items():
        text = text.replace(f"<!--{name}-->", part)
    return text


def _tiles(captures: Mapping[str, Mapping[str, Any]]) -> str:
    states = [entry["state"] for entry in captures.values()]
    done, failed = states.count("done"), states.count("failed")
    found = [value for entry in captures.values() if (value := figure(entry, "object")) is not None]
    hours = sum(seconds_of(entry) or 0.0 for entry in captures.values()) / 3600
    spent = f"{hours:,.1f} h" if hours >= 1 else f"{60 * hours:.1f} min"
    tiles = [
        (f"{done:,}", "done"),
        (f"{failed:,}", "failed"),
        (f"{len(states) - done - failed:,}", "not finished"),
        (f"{median(found):.1f} dB" if found else "–", "median PSNR, object"),
        (spent, "in all stages"),
        (f"{sum(bool(entry.get('warnings')) for entry in captures.values()):,}", "with warnings"),
    ]
    return "".join(f"<div class=tile><b>{value}</b><span>{label}</span></div>" for value, label in tiles)


def _row(name: str, entry: Mapping[str, Any], thumbnail: str) -> str:
    state, warnings = entry["state"], list(entry.get("warnings") or ())
    psnr, frame, seconds = figure(entry, "object"), figure(entry, "frame"), seconds_of(entry)
    values = {
        "name": name,
        "rank": RANKS.get(state, 3),
        "psnr": psnr,
        "frame": frame,
        "seconds": seconds,
        "retries": int(entry.get("retries") or 0),
        "warnings": len(warnings),
    }
    attributes = " ".join(
        f'data-{key}="{html.escape("" if value is None else str(value))}"' for key, value in values.items()
    )
    shown = html.escape(name)
    if state == "done":
        shown = f'<a href="{quote(name)}/report.html">{shown}</a>'
    reason = ""
    if state == "failed":
        log = f'<a href=".batch/logs/{quote(name)}.log">log</a>'
        reason = f"<p class=reason>{html.escape(str(entry.get('reason', '')))} ({log})</p>"
    picture = f'<img src="{thumbnail}" alt="photograph and fit">' if thumbnail else "<div class=none></div>"
    cells = [
        picture,
        f"<b>{shown}</b><small>{html.escape(str(entry.get('source', '')))}</small>",
        f"<span class=state>{html.escape(state)}</span>{reason}",
    ]
    numbers = [_number(psnr, 2), _number(frame, 2), _number(seconds, 1), str(values["retries"] or "")]
    return (
        f'<tr class="{html.escape(state)}" {attributes}>'
        + "".join(f"<td>{cell}</td>" for cell in cells)
        + "".join(f"<td class=number>{number}</td>" for number in numbers)
        + f"<td class=warnings>{_warnings(warnings)}</td></tr>"
    )


def _warnings(warnings: list[str]) -> str:
    if not warnings:
        return ""
    listed = "".join(f"<li>{html.escape(str(warning))}</li>" for warning in warnings)
    return f"<details><summary>{len(warnings)}</summary><ul>{listed}</ul></details>"


def _number(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _thumbnail(destination: Destination, name: str) -> str:
    found = str(destination.record(name).get("thumbnail", ""))
    return found if re.fullmatch(r"data:image/jpeg;base64,[A-Za-z0-9+/=]+", found) else ""
