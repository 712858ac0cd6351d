"""Fitted materials and lights beside the true ones: `python -m benchmarks.material_pictures RUN…`, into docs/images.

RUNs are finished and evaluated runs of HIR_SHARED's captures. Known of these are the albedo of the test views, the
light, and what was rendered (`benchmarks.true_materials`).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np
import torch
from hir_exporters.conventions import linear_to_srgb
from hir_exporters.textures.image_files import read_ldr
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from benchmarks.experiments.cells import ROOT
from benchmarks.experiments.pictures import on_paper
from benchmarks.true_materials import true_scene
from hir_core.capture import Camera
from hir_core.evaluation.truth_evaluation import in_world
from hir_core.metrics.light_metrics import compare_lights
from hir_core.plugins.manager import PluginManager
from hir_core.rendering.light_files import load_light
from hir_core.rendering.unlit_renderer import UnlitRenderer
from hir_core.run.finished_run import open_finished_run
from hir_core.run.run_directory import RunDirectory
from hir_core.scene import Material, Scene

PAGE = ROOT / "docs" / "images" / "materials.jpg"
VIEW = 5
"""Of the test split."""
SIDE, BAND = 224, 26
F0_SHOWN = 0.08
"""F0 that is drawn white: the largest that glTF and USD allow without metalness."""

Array: TypeAlias = NDArray[np.float32]
Tile: TypeAlias = tuple[Array, str]
"""sRGB (H, W, 3) and its caption."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", type=Path, nargs="+", metavar="RUN")
    plugins = PluginManager.discover()
    sheet([row for run in parser.parse_args().runs for row in rows_of(run, plugins)]).save(PAGE, quality=90)
    print(PAGE)


def rows_of(folder: Path, plugins: PluginManager) -> list[list[Tile]]:
    """The tiles of one run: the fit, and the truth below it."""
    run = open_finished_run(RunDirectory(folder))
    path = run.capture_path
    test = run.read_split(path, "test", plugins)
    camera, name = test.cameras[VIEW], test.views[VIEW].name
    pictures = folder / "evaluation" / "test"
    assert run.scene.environment is not None
    light = in_world(run.scene.environment)
    fit = [
        (read_ldr(pictures / f"{name}_fit.png")[..., :3], f"{path.name}, fit"),
        (_unlit(run.scene, camera), "albedo"),
        *_lobe_tiles(run.scene, camera),
    ]
    source = run.read_split(path, "train", plugins).environment
    if source is None:
        return [[*fit, (_toned(light, 1 / light.mean()), "light")]]
    known = in_world(load_light(source, test.world_from_source))
    bright = 0.5 / float(known.mean())
    albedo = run.read_split(path, "albedo_test", plugins).views[VIEW].pixels()
    assert albedo.mask is not None
    rendered = true_scene(path, test)
    truth = [
        (read_ldr(pictures / f"{name}_true.png")[..., :3], "photograph"),
        (_over_paper(albedo.color_linear, albedo.mask), "true albedo"),
        *_lobe_tiles(rendered, camera),
        (_toned(known, bright), "true light"),
    ]
    return [[*fit, (_toned(light, compare_lights(light, known).scale * bright), "light")], truth]


def _lobe_tiles(scene: Scene, camera: Camera) -> list[Tile]:
    assert scene.material is not None
    f0 = _array(scene.material.specular_albedo.mean(dim=-1, keepdim=True))
    tiles = []
    for name, values, white in (("F0", f0, F0_SHOWN), ("roughness", _array(scene.material.roughness.sqrt()), 1.0)):
        mean = f"{name} {values.mean():.3f}" if values.ndim == 1 else f"{name} {values.mean():.3f} on average"
        grey = torch.from_numpy(np.repeat(values / white, 3, axis=-1)).float()
        shown = replace(scene, material=Material("paper", grey, grey[:1], grey[:1]))
        # as values, not as light: linear on the page
        tiles.append((_unlit(shown, camera, linear=True), mean))
    return tiles


def _unlit(scene: Scene, camera: Camera, linear: bool = False) -> Array:
    found = UnlitRenderer(scene).render(camera)
    color = found[..., :3] / np.maximum(found[..., 3:], 1e-6)
    return _over_paper(color, found[..., 3], linear)


def _over_paper(color: Array, mask: Array, linear: bool = False) -> Array:
    shown = np.clip(color, 0, 1)
    return on_paper(np.concatenate([shown if linear else linear_to_srgb(shown), mask[..., None]], axis=-1))


def _toned(radiance: NDArray[np.floating], exposure: float) -> Array:
    scaled = np.maximum(radiance, 0) * exposure
    return np.asarray(linear_to_srgb(scaled / (1 + scaled)), np.float32)


def _array(values: torch.Tensor) -> Array:
    return np.asarray(values.detach().cpu().numpy(), np.float32)


def sheet(rows: Sequence[Sequence[Tile]]) -> Image.Image:
    """Tiles scaled to one height, with captions below; the aspect ratio is kept."""
    font = ImageFont.load_default(14)
    width = SIDE * (max(len(row) for row in rows) + 1)
    page = Image.new("RGB", (width, (SIDE + BAND) * len(rows)), (246, 246, 246))
    draw = ImageDraw.Draw(page)
    for number, row in enumerate(rows):
        left, top = 0, number * (SIDE + BAND)
        for picture, caption in row:
            size = (round(SIDE * picture.shape[1] / picture.shape[0]), SIDE)
            tile = Image.fromarray((np.clip(picture, 0, 1) * 255 + 0.5).astype(np.uint8))
            page.paste(tile.resize(size, Image.Resampling.LANCZOS), (left, top))
            draw.text((left + 8, top + SIDE + 5), caption, fill=(60, 60, 64), font=font)
            left += size[0]
    return page


if __name__ == "__main__":
    main()
