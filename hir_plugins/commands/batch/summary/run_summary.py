"""The figures, warnings and thumbnail of a finished run that the summary page displays."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

from hir_exporters.textures.pillow_images import open_image

from hir_core.files.contained_files import named_file
from hir_core.files.json_documents import read_json
from hir_core.run.run_directory import STAGE_NAMES, RunDirectory

THUMBNAIL_SIDE: Final = 112
"""Pixels."""


@dataclass(frozen=True)
class RunSummary:
    """What batch.json and batch.html say about one run."""

    psnr: Mapping[str, float | None]
    """Mean over the fitted views that the report displays, in dB: over the object's pixels and over the frame."""
    stage_seconds: Mapping[str, float]
    peak_memory_bytes: int
    photographs: int
    triangles: int | None
    warnings: Sequence[str]
    thumbnail: str
    """A JPEG as a data: URL; empty if no view was rendered."""

    def document(self) -> dict[str, Any]:
        """The summary as a JSON object."""
        return asdict(self)


def summarize_run(run: RunDirectory) -> RunSummary:
    """The summary of a finished run; reads run.json, timings.json and the report's images."""
    document, timings = run.read_run(), run.read_timings()
    path = run.report / "views.json"
    views = read_json(path)["views"] if path.exists() else []
    stages = timings.get("stages", {})
    warnings = [
        f"{stage}: {warning}"
        for stage in STAGE_NAMES
        for warning in document["stages"].get(stage, {}).get("warnings", ())
    ]
    return RunSummary(
        psnr={key: _mean([view[key] for view in views]) for key in ("object", "frame")},
        stage_seconds={stage: entry["seconds"] for stage, entry in stages.items()},
        peak_memory_bytes=max((entry["peak_memory_bytes"] for entry in stages.values()), default=0),
        photographs=document["capture"]["views"],
        triangles=document["stages"].get("bake", {}).get("report", {}).get("triangles"),
        warnings=warnings + [f"plugin: {problem}" for problem in document.get("plugin_problems", ())],
        thumbnail=_thumbnail(run, views),
    )


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None


def _thumbnail(run: RunDirectory, views: list[dict[str, Any]]) -> str:
    """The photograph with the lowest PSNR beside its fit, cropped to the object."""
    from PIL import Image, ImageChops, ImageOps

    rendered = [view for view in views if view["object"] is not None]
    if not rendered:
        return ""
    worst = min(rendered, key=lambda view: view["object"])
    side = THUMBNAIL_SIDE
    pair = Image.new("RGB", (2 * side, side))
    images = [open_image(named_file(run.path, run.report, worst[kind])).convert("RGB") for kind in ("true", "fit")]
    # the background is black
    box = ImageChops.lighter(*images).getbbox() or (0, 0, *images[0].size)
    for i, image in enumerate(images):
        scaled = ImageOps.contain(image.crop(box), (side - 4, side - 4), Image.Resampling.LANCZOS)
        pair.paste(scaled, (i * side + (side - scaled.width) // 2, (side - scaled.height) // 2))
    stream = io.BytesIO()
    pair.save(stream, format="JPEG", quality=80)
    return "data:image/jpeg;base64," + base64.b64encode(stream.getvalue()).decode("ascii")
