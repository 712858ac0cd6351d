"""Photographs beside their fit, textures and light, as HTML with the pictures inside."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hir_exporters.errors import InputError

from hir_core.files.json_documents import read_json
from hir_core.report.tables import number
from hir_core.run.run_directory import RunDirectory

TEXTURES = {
    "light": "Light, a panorama: its centre looks along +Z",
    "albedo": "Diffuse albedo",
    "specular": "Specular albedo, brightest shown white",
    "roughness": "Roughness",
    "normal": "Normals",
}
FIELDS = {"albedo": "diffuse_albedo", "specular": "specular_albedo"}
"""Names in the bake stage's report where they are not the picture's own."""

VALUES = {
    "albedo": "Diffuse albedo, one colour",
    "specular": "Specular albedo (F0), one value",
    "roughness": "Roughness, one value",
    "light": "Light",
    "normal": "Normals",
}

EMBEDDED_SIDE = 1024
"""Longest side of a picture inside report.html; those in report/ may be larger."""

THUMBNAIL_SIDE = 112


def comparison(directory: RunDirectory) -> str:
    """The slides of photograph and fit, and a strip of small pictures that choose between them."""
    shown = [view | {"folder": directory.report, "kind": "fitted"} for view in _views(directory)]
    for metrics in sorted(directory.path.glob("evaluation/*/metrics.json")):
        shown += _held_out(metrics)
    slides, strip = [], []
    for i, view in enumerate(shown):
        places = {kind: view["folder"] / str(view[kind]) for kind in ("true", "fit", "difference")}
        parts = {kind: picture_uri(place) for kind, place in places.items()}
        name, kind = html.escape(str(view["name"])), html.escape(str(view["kind"]))
        slides.append(
            f'<figure class=slide data-kind="{kind}"><div class=compare style="--at:50%">'
            f'<img class=fit src="{parts["fit"]}" alt="fit of {name}">'
            f'<img class=true src="{parts["true"]}" alt="photograph {name}">'
            f'<img class=difference src="{parts["difference"]}" alt="difference of {name}">'
            f'<input type=range min=0 max=100 value=50 aria-label="photograph or fit of {name}">'
            "<span class=left>photograph</span><span class=right>fit</span></div>"
            f"<figcaption><b>{name}</b> {kind} · object {number(view['object'], 2, ' dB')} · "
            f"frame {number(view['frame'], 2, ' dB')}{_measured_at(view)}</figcaption></figure>"
        )
        small = picture_uri(places["true"], THUMBNAIL_SIDE)
        strip.append(
            f'<button type=button class=thumb data-at={i} title="{name}, {kind}"><img src="{small}" alt=""></button>'
        )
    if not slides:
        return "<p class=quiet>No view with a mask to show.</p>"
    return f"{''.join(slides)}<div class=strip>{''.join(strip)}</div>"


def _measured_at(view: Mapping[str, Any]) -> str:
    """The size that figures are of, where it is not the photograph's."""
    return " · measured at {}×{}".format(*view["measured_at"]) if "measured_at" in view else ""


def textures(directory: RunDirectory, baked: Mapping[str, Any]) -> str:
    """Light and textures that were found; what is one value for the whole surface is said, not shown."""
    cells = []
    for name, caption in TEXTURES.items():
        path = directory.report / f"{name}.png"
        value = baked.get(FIELDS.get(name, name))
        if isinstance(value, float | int | list):
            cells.append(
                f"<figure class=constant><b>{_value(name, value)}</b><figcaption>{VALUES[name]}</figcaption></figure>"
            )
        elif path.exists():
            cells.append(
                f'<figure class="texture {name}"><img src="{picture_uri(path)}" alt="{name}">'
                f"<figcaption>{html.escape(caption)}</figcaption></figure>"
            )
    return "".join(cells)


def _value(name: str, value: float | list[float]) -> str:
    """A grey colour is one number; roughness is shown as engines have it, the square root of α."""
    values = [float(v) for v in value] if isinstance(value, list) else [float(value)]
    if name == "roughness":
        values = [v**0.5 for v in values]
    shown = values if max(values) - min(values) > 5e-4 else values[:1]
    return " ".join(f"{v:.3f}" for v in shown)


def picture_uri(path: Path, side: int = EMBEDDED_SIDE) -> str:
    """A picture as a data: address, a JPEG of at most `side` pixels a side."""
    from PIL import Image

    try:
        with Image.open(path) as opened:
            picture = opened.convert("RGB")
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error}); make it again with: hir report") from error
    picture.thumbnail((side, side), Image.Resampling.LANCZOS)
    stream = io.BytesIO()
    picture.save(stream, format="JPEG", quality=92, subsampling=0)
    return "data:image/jpeg;base64," + base64.b64encode(stream.getvalue()).decode("ascii")


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
        seen = "fitted" if metrics.parent.name == "train" else "unseen"
        label = f"{metrics.parent.name}, {seen}, {rank}"
        found.append(files_ | views[i]["psnr"] | {"name": views[i]["name"], "folder": metrics.parent, "kind": label})
    return found
