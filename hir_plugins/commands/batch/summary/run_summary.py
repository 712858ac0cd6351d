"""What the summary page shows of a finished run: figures, warnings and a small picture."""

from __future__ import annotations

import base64
import io
from typing import Any, Final

from hir_core.files.json_documents import read_json
from hir_core.run.run_directory import STAGES, RunDirectory

THUMBNAIL_SIDE: Final = 112


def summarize(run: RunDirectory) -> dict[str, Any]:
    """PSNR of the report's fitted views in dB, large ones reduced; seconds and memory of the stages, warnings, a
    thumbnail.
    """
    document, timings = run.read_run(), run.read_timings()
    path = run.report / "views.json"
    views = read_json(path)["views"] if path.exists() else []
    stages = timings.get("stages", {})
    warnings = [f"{s}: {w}" for s in STAGES for w in document["stages"].get(s, {}).get("warnings", ())]
    return {
        "psnr": {key: _mean([view[key] for view in views]) for key in ("object", "frame")},
        "stage_seconds": {stage: entry["seconds"] for stage, entry in stages.items()},
        "peak_memory_bytes": max((entry["peak_memory_bytes"] for entry in stages.values()), default=0),
        "photographs": document["capture"]["views"],
        "triangles": document["stages"].get("bake", {}).get("report", {}).get("triangles"),
        "warnings": warnings + [f"plugin: {problem}" for problem in document.get("plugin_problems", ())],
        "thumbnail": _thumbnail(run, views),
    }


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None


def _thumbnail(run: RunDirectory, views: list[dict[str, Any]]) -> str:
    """The worst view's photograph beside its fit, a JPEG as a data: address; empty where no view was rendered."""
    from PIL import Image, ImageChops, ImageOps

    shown = [view for view in views if view["object"] is not None]
    if not shown:
        return ""
    worst = min(shown, key=lambda view: view["object"])
    side = THUMBNAIL_SIDE
    pair = Image.new("RGB", (2 * side, side))
    pictures = [Image.open(run.report / worst[kind]).convert("RGB") for kind in ("true", "fit")]
    # around the object, which is all that is not black
    box = ImageChops.lighter(*pictures).getbbox() or (0, 0, *pictures[0].size)
    for i, picture in enumerate(pictures):
        shown_part = ImageOps.contain(picture.crop(box), (side - 4, side - 4), Image.Resampling.LANCZOS)
        pair.paste(shown_part, (i * side + (side - shown_part.width) // 2, (side - shown_part.height) // 2))
    stream = io.BytesIO()
    pair.save(stream, format="JPEG", quality=80)
    return "data:image/jpeg;base64," + base64.b64encode(stream.getvalue()).decode("ascii")
