"""The tiles at the top of the report: its headline figures."""

from __future__ import annotations

from markupsafe import Markup

from hir_core.report.page_templates import render
from hir_core.report.value_formatting import Document, duration, number, report_of

MAX_TILES = 8


def tiles(document: Document, timings: Document) -> Markup:
    """The main figures: PSNR of each split, time, triangles, texture, model, memory."""
    found: list[tuple[str, str]] = []
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
    return render("tiles.html", tiles=found[:MAX_TILES])
