"""Photographs beside their fit, textures and light, as HTML with embedded pictures."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hir_exporters.textures.pillow_images import open_image
from markupsafe import Markup

from hir_core.errors import InputError
from hir_core.files.json_documents import read_json
from hir_core.report.page_templates import render
from hir_core.report.tables import notice
from hir_core.report.value_formatting import number
from hir_core.run.run_directory import RunDirectory

TEXTURES = {
    "light": "Light as a panorama, centre +Z",
    "albedo": "Diffuse albedo",
    "specular": "Specular albedo, scaled to white",
    "roughness": "Roughness",
    "normal": "Normals",
}
FIELDS = {"albedo": "diffuse_albedo", "specular": "specular_albedo"}
"""Keys in the report of the bake stage that differ from the name of the picture."""

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


def comparison(directory: RunDirectory) -> Markup:
    """Slides of photograph, fit and difference, and a strip of thumbnails that choose between them."""
    shown = [view | {"folder": directory.report, "kind": "fitted"} for view in _fitted_views(directory)]
    for metrics in sorted(directory.path.glob("evaluation/*/metrics.json")):
        shown += _evaluated_views(metrics)
    if not shown:
        return notice("There is no view with a mask.")
    return render("slides.html", slides=[_slide(view) for view in shown])


def _slide(view: Mapping[str, Any]) -> dict[str, str]:
    paths = {kind: view["folder"] / str(view[kind]) for kind in ("true", "fit", "difference")}
    # the size is named where the figures are of a reduced photograph
    size = " · measured at {}×{}".format(*view["measured_at"]) if "measured_at" in view else ""
    figures = f"object {number(view['object'], 2, ' dB')} · frame {number(view['frame'], 2, ' dB')}"
    return {
        "name": str(view["name"]),
        "kind": str(view["kind"]),
        "caption": f"{view['kind']} · {figures}{size}",
        "photograph": picture_uri(paths["true"]),
        "fit": picture_uri(paths["fit"]),
        "difference": picture_uri(paths["difference"]),
        "thumbnail": picture_uri(paths["true"], THUMBNAIL_SIDE),
    }


def textures(directory: RunDirectory, baked: Mapping[str, Any]) -> Markup:
    """Light and textures as pictures; a parameter that is constant over the surface as its value."""
    tiles: list[dict[str, str | None]] = []
    for name, caption in TEXTURES.items():
        path = directory.report / f"{name}.png"
        value = baked.get(FIELDS.get(name, name))
        if isinstance(value, float | int | list):
            tiles.append({"name": name, "value": _value(name, value), "caption": VALUES[name]})
        elif path.exists():
            tiles.append({"name": name, "value": None, "picture": picture_uri(path), "caption": caption})
    return render("textures.html", tiles=tiles)


def _value(name: str, value: float | list[float]) -> str:
    """The value as text: one number for a grey colour; roughness as the perceptual √α."""
    values = [float(v) for v in value] if isinstance(value, list) else [float(value)]
    if name == "roughness":
        values = [v**0.5 for v in values]
    parts = values if max(values) - min(values) > 5e-4 else values[:1]
    return " ".join(f"{v:.3f}" for v in parts)


def picture_uri(path: Path, side: int = EMBEDDED_SIDE) -> str:
    """A picture as a `data:` URI: a JPEG with at most `side` pixels per side. `InputError` where it cannot be read."""
    from PIL import Image

    try:
        with open_image(path) as opened:
            picture = opened.convert("RGB")
    except (InputError, OSError) as error:
        raise InputError(f"{path} cannot be read ({error}); write it again with: hir report") from error
    picture.thumbnail((side, side), Image.Resampling.LANCZOS)
    stream = io.BytesIO()
    picture.save(stream, format="JPEG", quality=92, subsampling=0)
    return "data:image/jpeg;base64," + base64.b64encode(stream.getvalue()).decode("ascii")


def _fitted_views(directory: RunDirectory) -> list[dict[str, Any]]:
    path = directory.report / "views.json"
    return list(read_json(path)["views"]) if path.exists() else []


def _evaluated_views(metrics: Path) -> list[dict[str, Any]]:
    """The best, the median and the worst view of an evaluation."""
    document = read_json(metrics)
    views = sorted(document["views"], key=lambda view: view["psnr"]["object"] or 0.0)
    chosen = {0: "worst", len(views) // 2: "median", len(views) - 1: "best"}
    result = []
    for i, rank in chosen.items():
        stem = Path(views[i]["file"]).stem
        files = {kind: f"{stem}_{kind}.png" for kind in ("true", "fit", "difference")}
        use = "fitted" if metrics.parent.name == "train" else "unseen"
        label = f"{metrics.parent.name}, {use}, {rank}"
        result.append(files | views[i]["psnr"] | {"name": views[i]["name"], "folder": metrics.parent, "kind": label})
    return result
