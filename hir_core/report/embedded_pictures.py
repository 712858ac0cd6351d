"""Photographs beside their fit, textures and light, as HTML with embedded pictures."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hir_exporters.textures.pillow_images import open_image
from markupsafe import Markup

from hir_core.errors import InputError
from hir_core.files.contained_files import named_file, regular_file_within
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
    "metalness": "Metalness",
    "normal": "Normals",
}
FIELDS = {"albedo": "diffuse_albedo", "specular": "specular_albedo"}
"""Keys in the report of the bake stage that differ from the name of the picture."""

VALUES = {
    "albedo": "Diffuse albedo, one colour",
    "specular": "Specular albedo (F0), one value",
    "roughness": "Roughness, one value",
    "metalness": "Metalness, one value",
    "light": "Light",
    "normal": "Normals",
}

COMPARED = {
    "compared_photograph": "A photograph",
    "compared_scan": "The scan's own texture, without a light",
    "compared_vertices": "The photographs' colours at the vertices, without a light",
    "compared_material": "The new material, in the light that was found",
}
"""Pictures beside a photograph, by the name of the file."""

RELIT = {
    "relit_scan": "The scan's own texture, relit",
    "relit_vertices": "The photographs' colours at the vertices, relit",
    "relit_material": "The new material, relit",
}
"""Pictures under another light, by the name of the file."""

MAP_ERRORS = {
    "map_condition": "Green: well observed. Red: by too few photographs. Blue: only in shadow. Yellow: only under "
    "highlights",
    "error_base_color": "Base colour: dark 0, white 0.2 and more",
    "error_metalness": "Metalness: dark 0, white 0.2 and more",
    "error_roughness": "Roughness: dark 0, white 0.2 and more",
    "error_specular": "Specular albedo (F0): dark 0, white 0.02 and more",
}
"""Pictures of how certain the maps are, by the name of the file."""

EMBEDDED_SIDE = 1024
"""Longest side of a picture inside report.html; those in report/ may be larger."""

THUMBNAIL_SIDE = 112


def comparison(directory: RunDirectory) -> Markup:
    """Slides of photograph, fit and difference, and a strip of thumbnails that choose between them."""
    shown = _fitted_views(directory)
    for metrics in sorted(directory.path.glob("evaluation/*/metrics.json")):
        shown += _evaluated_views(directory, metrics)
    if not shown:
        return notice("There is no view with a mask.")
    return render("slides.html", slides=[_slide(view) for view in shown])


@dataclass(frozen=True)
class _ShownView:
    """One view of the page: what is taken from views.json or metrics.json, and nothing else of them."""

    name: str
    kind: str
    true: Path
    fit: Path
    difference: Path
    object_psnr: float | None
    frame_psnr: float | None
    measured_at: tuple[int, int] | None = None
    """Width and height of a photograph that was reduced before the figures were taken."""


def _slide(view: _ShownView) -> dict[str, str]:
    size = "" if view.measured_at is None else " · measured at {:d}×{:d}".format(*view.measured_at)
    figures = f"object {number(view.object_psnr, 2, ' dB')} · frame {number(view.frame_psnr, 2, ' dB')}"
    return {
        "name": view.name,
        "kind": view.kind,
        "caption": f"{view.kind} · {figures}{size}",
        "photograph": picture_uri(view.true),
        "fit": picture_uri(view.fit),
        "difference": picture_uri(view.difference),
        "thumbnail": picture_uri(view.true, THUMBNAIL_SIDE),
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
            regular_file_within(directory.path, path)
            tiles.append({"name": name, "value": None, "picture": picture_uri(path), "caption": caption})
    count = len(list(directory.report.glob("light_take_*.png")))
    captions = {f"light_take_{number}": f"Light of take {number + 1} as a panorama" for number in range(count)}
    tiles += _tiles(directory, captions)
    return render("textures.html", tiles=tiles)


@dataclass(frozen=True)
class BeforeAndAfter:
    """A texture from photographs beside the new material."""

    is_scan: bool
    """The texture is the scan's own; otherwise it is the photographs' colours at the vertices."""
    compared: Markup
    """Tiles beside a photograph."""
    relit: Markup
    """Tiles under another light."""


def before_and_after(directory: RunDirectory) -> BeforeAndAfter | None:
    """The pictures of `relit_pictures`; None where a run has none, or not all of them."""
    compared, relit = _tiles(directory, COMPARED), _tiles(directory, RELIT)
    if len(compared) != len(COMPARED) - 1 or len(relit) != len(RELIT) - 1:  # one texture of two
        return None
    is_scan = any(tile["name"] == "relit_scan" for tile in relit)
    return BeforeAndAfter(is_scan, *(render("textures.html", tiles=tiles) for tiles in (compared, relit)))


def _tiles(directory: RunDirectory, captions: Mapping[str, str]) -> list[dict[str, str | None]]:
    """One tile for each of the pictures that exist."""
    tiles: list[dict[str, str | None]] = []
    for name, caption in captions.items():
        path = directory.report / f"{name}.png"
        if path.exists():
            regular_file_within(directory.path, path)
            tiles.append({"name": name, "value": None, "picture": picture_uri(path), "caption": caption})
    return tiles


def map_errors(directory: RunDirectory) -> Markup:
    """How certain the maps are; empty where a run has no such pictures."""
    tiles = _tiles(directory, MAP_ERRORS)
    return render("textures.html", tiles=tiles) if tiles else Markup()


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
    except (InputError, OSError, RuntimeError, SyntaxError, ValueError) as error:  # decoders, on damaged pictures
        raise InputError(f"{path} cannot be read ({error}); write it again with: hir report") from error
    picture.thumbnail((side, side), Image.Resampling.LANCZOS)
    stream = io.BytesIO()
    picture.save(stream, format="JPEG", quality=92, subsampling=0)
    return "data:image/jpeg;base64," + base64.b64encode(stream.getvalue()).decode("ascii")


def _fitted_views(directory: RunDirectory) -> list[_ShownView]:
    path = directory.report / "views.json"
    if not path.exists():
        return []
    views = read_json(regular_file_within(directory.path, path))["views"]
    return [_shown_view(directory, directory.report, view, view, str(view["name"]), "fitted") for view in views]


def _evaluated_views(directory: RunDirectory, metrics: Path) -> list[_ShownView]:
    """The best, the median and the worst view of an evaluation."""
    document = read_json(regular_file_within(directory.path, metrics))
    views = sorted(document["views"], key=lambda view: view["psnr"]["object"] or 0.0)
    chosen = {0: "worst", len(views) // 2: "median", len(views) - 1: "best"}
    result = []
    for i, rank in chosen.items():
        stem = Path(views[i]["file"]).stem
        files = {kind: f"{stem}_{kind}.png" for kind in ("true", "fit", "difference")}
        use = "fitted" if metrics.parent.name == "train" else "unseen"
        label = f"{metrics.parent.name}, {use}, {rank}"
        result.append(_shown_view(directory, metrics.parent, files, views[i]["psnr"], str(views[i]["name"]), label))
    return result


def _shown_view(
    directory: RunDirectory,
    folder: Path,
    files: Mapping[str, Any],
    figures: Mapping[str, Any],
    name: str,
    kind: str,
) -> _ShownView:
    """`files` names pictures in `folder`, `figures` has `object` and `frame` in dB and maybe `measured_at`."""
    true, fit, difference = (named_file(directory.path, folder, files[key]) for key in ("true", "fit", "difference"))
    size = figures.get("measured_at")
    if size is not None:
        width, height = map(int, size)
        size = (width, height)
    return _ShownView(name, kind, true, fit, difference, figures["object"], figures["frame"], size)
