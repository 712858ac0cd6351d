"""The numbers of a report: tiles and tables as HTML, from run.json and timings.json."""

from __future__ import annotations

import html
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hir_core.run.run_directory import STAGE_NAMES

Document = Mapping[str, Any]

MOST_TILES = 8


def tiles(document: Document, timings: Document) -> str:
    """The few figures that a person wants first."""
    found = []
    metrics = document.get("metrics", {})
    for split in sorted(metrics, key=lambda name: (name != "test", name)):
        found.append((number(metrics[split]["psnr"]["object"], 1, " dB"), f"PSNR on the object, {split}"))
        if split == "test":
            found.append((number(metrics[split]["psnr"]["frame"], 1, " dB"), f"PSNR of the frame, {split}"))
    seconds = timings.get("seconds")
    if seconds:
        found.append((duration(seconds), "for all stages"))
    baked = report_of(document, "bake")
    if "triangles" in baked:
        found.append((f"{baked['triangles']:,}", "triangles"))
        size = baked.get("diffuse_albedo")
        found.append((size.replace(" x ", " × ") if isinstance(size, str) else "one colour", "diffuse texture"))
        found.append((str(baked.get("model")), "reflectance model"))
    memory = max([stage.get("peak_memory_bytes", 0) for stage in timings.get("stages", {}).values()] or [0])
    if memory:
        found.append((f"{memory / 2**30:.1f} GiB", "peak memory"))
    return "".join(
        f"<div class=tile><b>{html.escape(value)}</b><span>{html.escape(label)}</span></div>"
        for value, label in found[:MOST_TILES]
    )


def ladder(document: Document, seconds: Sequence[float]) -> str:
    """Every model that was tried, what held-out views said of it, and how long that took.

    `seconds` tells when each vote ended; the time of a vote's first candidate includes a control fitted for it.
    """
    rows = report_of(document, "reflectance").get("ladder") or []
    if not rows:
        rung = report_of(document, "reflectance").get("rung")
        told = f"<p class=quiet>No models were compared; {html.escape(str(rung))} was set.</p>" if rung else ""
        return told + _settled(document)
    level = [row["held_out_db"] for row in rows]
    low, span = min(level) - 1, max(max(level) - min(level) + 1, 1e-9)
    spent = np.diff(seconds, prepend=0.0).tolist() if len(seconds) == len(rows) else [None] * len(rows)
    cells = []
    for i, (row, took) in enumerate(zip(rows, spent, strict=True)):
        gain = "the start" if i == 0 else f"{number(row['gain_db'], 2)} ± {number(row['noise_db'], 2)}"
        kept = "kept" if row["kept"] else "left"
        cells.append(
            f"<tr class={kept}><th>{html.escape(row['name'])}</th>"
            f"<td class=bar><i style='width:{100 * (row['held_out_db'] - low) / span:.1f}%'></i></td>"
            f"<td class=number>{row['held_out_db']:.2f} dB</td><td class=number>{gain}</td>"
            f"<td class=number>{'–' if took is None else duration(took)}</td><td>{kept}</td></tr>"
        )
    head = _head("", "held-out views", "", "gain, dB", "time", "")
    return f"<table class=ladder>{head}{''.join(cells)}</table>{_settled(document)}"


def _settled(document: Document) -> str:
    """What path tracing the last albedo brought."""
    found = report_of(document, "reflectance").get("settled") or {}
    if "gain_db" not in found:
        return ""
    gain = f"{number(found['gain_db'], 2)} ± {number(found['noise_db'], 2)} dB"
    return (
        f"<p class=quiet>The albedo solved once more under what {html.escape(found['renderer'])} shows: held-out views "
        f"{found['before_db']:.2f} → {found['after_db']:.2f} dB ({gain}): {'kept' if found['kept'] else 'left'}.</p>"
    )


def stages(document: Document, timings: Document) -> str:
    """Where the time went."""
    entries = timings.get("stages", {})
    longest = max([entry.get("seconds", 0.0) for entry in entries.values()] or [0.0]) or 1.0
    rows = []
    for stage in STAGE_NAMES:
        if stage not in document["stages"]:
            continue
        seconds = float(entries.get(stage, {}).get("seconds", 0.0))
        memory = entries.get(stage, {}).get("peak_memory_bytes", 0) / 2**30
        told = ", ".join(facts(report_of(document, stage)))
        rows.append(
            f"<tr><th>{stage}</th><td class=number>{seconds:.1f} s</td>"
            f"<td class=bar><i style='width:{100 * seconds / longest:.1f}%'></i></td>"
            f"<td class=number>{memory:.1f} GiB</td><td class=told>{html.escape(told)}</td></tr>"
        )
    return f"<table class=stages>{_head('', 'time', '', 'peak memory', '')}{''.join(rows)}</table>"


def facts(report: Document) -> list[str]:
    """Numbers and words of a stage's report that fit into a line."""
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
        if len(text) <= 40:
            found.append(f"{name.replace('_', ' ')} {text}")
    return found[:8]


def evaluations(document: Document) -> str:
    """What `hir evaluate` found on photographs that were never fitted."""
    rows = []
    for split, m in document.get("metrics", {}).items():
        light = m.get("light", {})
        lit = "its own light" if light.get("fitted") else f"relit by {light.get('file')}"
        orb = m.get("stanford_orb", {})
        cells = [
            *(number(m[key][part], 2) for key in ("psnr", "psnr_scaled") for part in ("frame", "object")),
            *(number(m.get(key), 4) for key in ("ssim", "lpips", "flip", "iou")),
            *(number(orb.get(key), 2) for key in ("psnr_h", "psnr_l")),
        ]
        rows.append(
            f"<tr><th>{html.escape(split)}</th><td>{html.escape(lit)}</td>"
            + "".join(f"<td class=number>{cell}</td>" for cell in cells)
            + "</tr>"
        )
    if not rows:
        return "<p class=quiet>Not evaluated on unseen photographs yet: <code>hir evaluate RUN</code>.</p>"
    heads = (
        "",
        "",
        "PSNR frame",
        "object",
        "scaled frame",
        "object",
        "SSIM",
        "LPIPS",
        "FLIP",
        "mask IoU",
        "ORB PSNR-H",
        "ORB PSNR-L",
    )
    return f"<table class=evaluations>{_head(*heads)}{''.join(rows)}</table>"


def truth(document: Document) -> str:
    """What was compared with a true mesh, albedo and light; nothing where none was."""
    rows = []
    for split, m in document.get("metrics", {}).items():
        surface, albedo, light = (m.get(key) or {} for key in ("surface", "albedo", "light_error"))
        if not (surface or albedo or light):
            continue
        seen, balls = surface.get("seen", {}), light.get("spheres", {})
        cells = [
            number(seen.get("chamfer"), 5),
            number(seen.get("f_score", {}).get("0.005"), 3),
            number(seen.get("normal_error_deg"), 1, "°"),
            number(albedo.get("psnr"), 2, " dB"),
            number(albedo.get("psnr_scaled"), 2, " dB"),
            *(number(balls.get(ball), 3) for ball in ("mirror", "silver", "diffuse")),
        ]
        rows.append(f"<tr><th>{html.escape(split)}</th>{''.join(f'<td class=number>{c}</td>' for c in cells)}</tr>")
    if not rows:
        return ""
    heads = (
        "",
        "Chamfer, radii",
        "F at .005",
        "normals",
        "albedo",
        "scaled",
        "light: mirror ball",
        "silver",
        "diffuse",
    )
    return f"<table class=evaluations>{_head(*heads)}{''.join(rows)}</table>"


def exports(document: Document) -> str:
    """What each written file was found to be when it was read back."""
    rows = []
    for name, report in report_of(document, "export").items():
        verified = report.get("verified", {}) if isinstance(report, Mapping) else {}
        if "psnr" in verified:
            found = f"{verified['psnr']['object']:.1f} dB"
        else:
            found = str(verified.get("not_rendered") or verified.get("not_read") or "read back")
        brdf = f"{verified['brdf']:.1%}" if "brdf" in verified else "–"
        rows.append(
            f"<tr><th>{html.escape(name)}</th><td class=number>{brdf}</td><td class=number>{html.escape(found)}</td>"
            f"<td>{html.escape(str(verified.get('rendered', '')))}</td></tr>"
        )
    if not rows:
        return "<p class=quiet>Nothing is exported yet: <code>hir export RUN</code>.</p>"
    return f"<table class=evaluations>{_head('', 'material off by', 'rendered again', 'as')}{''.join(rows)}</table>"


def warnings(document: Document) -> str:
    """Everything that the run advised."""
    found = [(stage, w) for stage in STAGE_NAMES for w in document["stages"].get(stage, {}).get("warnings", ())]
    found += [("plugin", problem) for problem in document.get("plugin_problems", ())]
    if not found:
        return "<p class=quiet>None.</p>"
    items = "".join(f"<li><b>{html.escape(s)}</b> {html.escape(w)}</li>" for s, w in found)
    return f"<ul class=warnings>{items}</ul>"


def details(title: str, content: Any) -> str:
    """Something long that opens on demand."""
    text = html.escape(json.dumps(content, indent=1, ensure_ascii=False))
    return f"<details><summary>{title}</summary><pre>{text}</pre></details>"


def report_of(document: Document, stage: str) -> Document:
    """What a stage said of itself; empty where it did not run."""
    report: Document = document["stages"].get(stage, {}).get("report", {})
    return report


def number(value: float | None, digits: int, unit: str = "") -> str:
    """With so many digits; a dash where there is none."""
    return "–" if value is None else f"{value:.{digits}f}{unit}"


def duration(seconds: float) -> str:
    """In the unit that reads best."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.1f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _head(*names: str) -> str:
    return "<tr class=head>" + "".join(f"<th>{html.escape(name)}</th>" for name in names) + "</tr>"
