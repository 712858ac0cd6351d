"""Pictures of relighting and editing: `python -m benchmarks.experiments.pictures RUN`, into docs/images.

RUN is a finished run of captures/spot, evaluated on relight_0 and relight_1; lights come from HIR_SHARED/envmaps.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np
from hir_exporters.scene_format import load_scene
from hir_exporters.textures.image_files import read_ldr
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from benchmarks.experiments.cells import ROOT
from hir_core.plugins.manager import PluginManager
from hir_core.rendering.asset_edit import AssetEdit, apply_edit, render_asset

IMAGES = ROOT / "docs" / "images"
SIDE = 320
TURN_DEG = 215.0
"""Azimuth in degrees at which the cow faces the camera."""

GROUND = 0.965
"""sRGB of the background."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    options = parser.parse_args()
    lights = Path(os.environ.get("HIR_SHARED", ROOT.parent / "shared")) / "envmaps"
    edits = {
        "as fitted": AssetEdit(),
        "roughness x 2.2": AssetEdit(roughness=2.2),
        "roughness x 0.35": AssetEdit(roughness=0.35),
        "albedo x 1 0.45 0.4": AssetEdit(tint=(1.0, 0.45, 0.4)),
        "in a studio": AssetEdit(light=f"{lights / 'studio.hdr'}*0.3"),
        "at sunrise": AssetEdit(light=f"{lights / 'sunrise.hdr'}*0.6"),
    }
    plugins = PluginManager.discover()
    asset = load_scene(options.run / "scene")
    tiles = {
        name: on_paper(render_asset(apply_edit(asset, edit), plugins, SIDE, TURN_DEG)) for name, edit in edits.items()
    }
    sheet([list(tiles.values())], [list(tiles)], IMAGES / "experiments_edit.jpg")
    rows, captions = [], []
    for split, light in (("relight_0", "city"), ("relight_1", "studio")):
        folder = options.run / "evaluation" / split
        stems = sorted(path.name.removesuffix("_true.png") for path in folder.glob("*_true.png"))
        shown = [stems[0], stems[len(stems) // 2]]
        rows.append([small(read_ldr(folder / f"{s}_{k}.png")) for s in shown for k in ("true", "fit", "difference")])
        captions.append([f"{k}, {light}" for _ in shown for k in ("photograph", "relit fit", "difference")])
    sheet(rows, captions, IMAGES / "experiments_relight.jpg")


def on_paper(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """The picture composited over the background."""
    alpha = picture[..., 3:]
    return np.asarray(picture[..., :3] * alpha + GROUND * (1 - alpha), np.float32)


def small(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """At most `SIDE` pixels."""
    image = Image.fromarray((np.clip(picture[..., :3], 0, 1) * 255 + 0.5).astype(np.uint8))
    return np.asarray(image.resize((SIDE, SIDE), Image.Resampling.LANCZOS), np.float32) / 255


def sheet(rows: list[list[NDArray[np.float32]]], captions: list[list[str]], path: Path) -> None:
    """Tiles with a caption below each."""
    band = 30
    font = ImageFont.load_default(15)
    width, height = SIDE * len(rows[0]), (SIDE + band) * len(rows)
    page = Image.new("RGB", (width, height), (246, 246, 246))
    draw = ImageDraw.Draw(page)
    for j, (tiles, names) in enumerate(zip(rows, captions, strict=True)):
        for i, (tile, name) in enumerate(zip(tiles, names, strict=True)):
            page.paste(
                Image.fromarray((np.clip(tile, 0, 1) * 255 + 0.5).astype(np.uint8)), (i * SIDE, j * (SIDE + band))
            )
            draw.text((i * SIDE + 10, j * (SIDE + band) + SIDE + 6), name, fill=(60, 60, 64), font=font)
    page.save(path, quality=88)
    print(path)


if __name__ == "__main__":
    main()
