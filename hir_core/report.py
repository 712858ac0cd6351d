"""The report of a run: `report/*.png` and `report.html`, one file that needs nothing beside it."""

from __future__ import annotations

import base64
import html
import io
import json
from collections.abc import Callable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hir_exporters.atomic import write_text_atomic
from hir_exporters.errors import InputError

from hir_core.curves import curve_svg
from hir_core.listener import read_curves
from hir_core.run_directory import STAGES, RunDirectory, read_json, write_json

if TYPE_CHECKING:
    from hir_core.manager import PluginManager

TEXTURES = {
    "light": "Light, a panorama: its centre looks along +Z",
    "albedo": "Diffuse albedo",
    "specular": "Specular albedo, brightest shown white",
    "roughness": "Roughness",
    "normal": "Normals",
}
EMBEDDED_SIDE = 1024
"""Longest side of a picture inside report.html; the full ones lie in report/."""

SHOWN_CURVES = 8


def write_report(
    directory: RunDirectory, plugins: PluginManager, on_message: Callable[[str], None] | None = None
) -> Path:
    """Renders the pictures and writes the page; returns its path."""
    from hir_core.report_pictures import write_pictures

    views = write_pictures(directory, plugins, on_message)
    write_json(directory.report / "views.json", {"views": views})
    return refresh_page(directory)


def refresh_page(directory: RunDirectory) -> Path:
    """Writes report.html from what lies in the folder, rendering nothing."""
    document = directory.read_run()
    assets = files("hir_core") / "report_page"
    parts = {
        "css": (assets / "page.css").read_text(encoding="utf-8"),
        "js": (assets / "page.js").read_text(encoding="utf-8"),
        "title": html.escape(str(document["capture"]["name"])),
        "lead": _lead(document),
        "figures": _figures(directory, document),
        "comparison": _comparison(directory),
        "textures": _textures(directory),
        "curves": _curves(directory),
        "stages": _stages(directory, document),
        "evaluations": _evaluations(document),
        "exports": _exports(document),
        "warnings": _warnings(document),
        "settings": _details("Settings", document["settings"]),
        "machine": _details("Machine", directory.read_timings().get("machine", {})),
        "versions": _details("Versions", document["versions"]),
        "plugins": _details("Plugins", document["plugins"]),
        "version": html.escape(str(document["versions"].get("hir", ""))),
    }
    page = (assets / "page.html").read_text(encoding="utf-8")
    for name, text in parts.items():
        page = page.replace(f"<!--{name}-->", text)
    path = directory.path / "report.html"
    write_text_atomic(path, page)
    return path


def _lead(document: Mapping[str, Any]) -> str:
    baked = _report_of(document, "bake")
    triangles = baked.get("triangles")
    made = f"a mesh of {triangles:,} triangles with its textures and light" if triangles else "an unfinished asset"
    count, preset = document["capture"]["views"], document["settings"]["preset"]
    return html.escape(f"{count} photographs became {made}. Preset {preset}, seed {document['seed']}.")


def _figures(directory: RunDirectory, document: Mapping[str, Any]) -> str:
    tiles = []
    for split, means in document.get("metrics", {}).items():
        tiles.append((_number(means["psnr"]["object"], 2, " dB"), f"PSNR, object, {split}"))
        tiles.append((_number(means["psnr"]["frame"], 2, " dB"), f"PSNR, frame, {split}"))
    seconds = directory.read_timings().get("seconds")
    if seconds:
        tiles.append((f"{seconds / 60:.1f} min" if seconds >= 90 else f"{seconds:.0f} s", "in all stages"))
    baked = _report_of(document, "bake")
    if "triangles" in baked:
        tiles.append((f"{baked['triangles']:,}", "triangles"))
        size = baked.get("diffuse_albedo")
        tiles.append((str(size) if isinstance(size, str) else "one colour", "diffuse texture"))
        tiles.append((str(baked.get("model")), "reflectance model"))
    return "".join(
        f"<div class=tile><b>{html.escape(v)}</b><span>{html.escape(label)}</span></div>" for v, label in tiles[:8]
    )


def _comparison(directory: RunDirectory) -> str:
    shown = [view | {"folder": directory.report, "kind": "fitted"} for view in _views(directory)]
    for metrics in sorted(directory.path.glob("evaluation/*/metrics.json")):
        shown += _held_out(metrics)
    slides = []
    for view in shown:
        pictures = {kind: picture_uri(view["folder"] / str(view[kind])) for kind in ("true", "fit", "difference")}
        name, kind = html.escape(str(view["name"])), html.escape(str(view["kind"]))
        slides.append(
            f'<figure class=slide data-kind="{kind}"><div class=compare style="--at:50%">'
            f'<img class=fit src="{pictures["fit"]}" alt="fit of {name}">'
            f'<img class=true src="{pictures["true"]}" alt="photograph {name}">'
            f'<img class=difference src="{pictures["difference"]}" alt="difference of {name}">'
            f'<input type=range min=0 max=100 value=50 aria-label="photograph or fit of {name}">'
            "<span class=left>photograph</span><span class=right>fit</span></div>"
            f"<figcaption><b>{name}</b> {kind} · object {_number(view['object'], 2, ' dB')} · "
            f"frame {_number(view['frame'], 2, ' dB')}</figcaption></figure>"
        )
    return "".join(slides) or "<p>No view with a mask to show.</p>"


def _views(directory: RunDirectory) -> list[dict[str, Any]]:
    path = directory.report / "views.json"
    return list(read_json(path)["views"]) if path.exists() else []


def _held_out(metrics: Path) -> list[dict[str, Any]]:
    """Best, middle and worst view of an evaluation."""
    document = read_json(metrics)
    views = sorted(document["views"], key=lambda view: view["psnr"]["object"] or 0.0)
    chosen = {0: "worst", len(views) // 2: "middle", len(views) - 1: "best"}
    found = []
    for i, rank in chosen.items():
        stem = Path(views[i]["file"]).stem
        files_ = {kind: f"{stem}_{kind}.png" for kind in ("true", "fit", "difference")}
        label = f"{metrics.parent.name}, unseen, {rank}"
        found.append(files_ | views[i]["psnr"] | {"name": views[i]["name"], "folder": metrics.parent, "kind": label})
    return found


def _textures(directory: RunDirectory) -> str:
    cells = []
    for name, caption in TEXTURES.items():
        path = directory.report / f"{name}.png"
        if path.exists():
            cells.append(
                f'<figure class="texture {name}"><img src="{picture_uri(path)}" alt="{name}">'
                f"<figcaption>{html.escape(caption)}</figcaption></figure>"
            )
    return "".join(cells)


def _curves(directory: RunDirectory) -> str:
    shown = []
    for stage in STAGES:
        curves = read_curves(directory.stage(stage) / "curves.npz")
        for name in sorted(curves)[:SHOWN_CURVES]:
            steps, values = curves[name]
            if len(values) > 1:
                shown.append(curve_svg(f"{stage}: {name.replace('_', ' ')}", steps, values))
    return "".join(shown) or "<p>No stage reported a curve.</p>"


def _stages(directory: RunDirectory, document: Mapping[str, Any]) -> str:
    timings = directory.read_timings().get("stages", {})
    longest = max([entry.get("seconds", 0.0) for entry in timings.values()] or [0.0]) or 1.0
    rows = []
    for stage in STAGES:
        if stage not in document["stages"]:
            continue
        seconds = float(timings.get(stage, {}).get("seconds", 0.0))
        memory = timings.get(stage, {}).get("peak_memory_bytes", 0) / 2**30
        facts = ", ".join(_facts(_report_of(document, stage)))
        rows.append(
            f"<tr><th>{stage}</th><td class=number>{seconds:.1f} s</td>"
            f"<td class=bar><i style='width:{100 * seconds / longest:.1f}%'></i></td>"
            f"<td class=number>{memory:.1f} GiB</td><td>{html.escape(facts)}</td></tr>"
        )
    return "<table class=stages>" + "".join(rows) + "</table>"


def _facts(report: Mapping[str, Any]) -> list[str]:
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


def _evaluations(document: Mapping[str, Any]) -> str:
    rows = []
    for split, m in document.get("metrics", {}).items():
        light = m.get("light", {})
        lit = "its own light" if light.get("fitted") else f"relit by {light.get('file')}"
        cells = [
            *(_number(m[key][part], 2) for key in ("psnr", "psnr_scaled") for part in ("frame", "object")),
            _number(m["ssim"], 4),
            _number(m["lpips"], 4),
        ]
        rows.append(
            f"<tr><th>{html.escape(split)}</th><td>{html.escape(lit)}</td>"
            + "".join(f"<td class=number>{cell}</td>" for cell in cells)
            + "</tr>"
        )
    if not rows:
        return "<p>Not evaluated on unseen photographs yet: <code>hir evaluate RUN</code>.</p>"
    head = "".join(f"<th>{h}</th>" for h in ("", "", "PSNR frame", "object", "scaled frame", "object", "SSIM", "LPIPS"))
    return f"<table class=evaluations><tr>{head}</tr>{''.join(rows)}</table>"


def _exports(document: Mapping[str, Any]) -> str:
    """What each written file was found to be when it was read back."""
    rows = []
    for name, report in _report_of(document, "export").items():
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
        return "<p>Nothing is exported yet: <code>hir export RUN</code>.</p>"
    head = "".join(f"<th>{h}</th>" for h in ("", "material off by", "rendered again", "as"))
    return f"<table class=evaluations><tr>{head}</tr>{''.join(rows)}</table>"


def _warnings(document: Mapping[str, Any]) -> str:
    found = [(stage, w) for stage in STAGES for w in document["stages"].get(stage, {}).get("warnings", ())]
    found += [("plugin", problem) for problem in document.get("plugin_problems", ())]
    if not found:
        return "<p class=quiet>None.</p>"
    return "<ul>" + "".join(f"<li><b>{html.escape(s)}</b> {html.escape(w)}</li>" for s, w in found) + "</ul>"


def _details(title: str, content: Any) -> str:
    text = html.escape(json.dumps(content, indent=1, ensure_ascii=False))
    return f"<details><summary>{title}</summary><pre>{text}</pre></details>"


def _report_of(document: Mapping[str, Any], stage: str) -> Mapping[str, Any]:
    report: Mapping[str, Any] = document["stages"].get(stage, {}).get("report", {})
    return report


def _number(value: float | None, digits: int, unit: str = "") -> str:
    return "–" if value is None else f"{value:.{digits}f}{unit}"


def picture_uri(path: Path) -> str:
    """A picture as a data: address, a JPEG of at most `EMBEDDED_SIDE` pixels a side."""
    from PIL import Image

    try:
        with Image.open(path) as opened:
            picture = opened.convert("RGB")
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error}); make it again with: hir report") from error
    picture.thumbnail((EMBEDDED_SIDE, EMBEDDED_SIDE), Image.Resampling.LANCZOS)
    stream = io.BytesIO()
    picture.save(stream, format="JPEG", quality=92, subsampling=0)
    return "data:image/jpeg;base64," + base64.b64encode(stream.getvalue()).decode("ascii")
