"""Composes docs/images/photos_to_asset.jpg from a finished run: `python tools/make_readme_picture.py RUN SPLIT`.

Left, four photographs; then the mesh, its albedo, a render under the fitted light from a side no photograph shows, and
one under the light of SPLIT (such as relight_0). Everything is made by hir from the run's folder and its capture.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from hir_core.metrics import composite, unassociate
from hir_core.plugins.manager import PluginManager
from hir_core.rendering.light_files import load_light
from hir_core.rendering.orbit_cameras import orbit_cameras
from hir_core.rendering.photographs import masked_photograph
from hir_core.rendering.reference_renderer import reference_renderer, render_view
from hir_core.rendering.view_selection import evenly_spaced_indices
from hir_core.run.finished_run import FinishedRun, open_finished_run
from hir_core.run.run_directory import open_run
from hir_core.scene import EnvironmentMap, Material, Scene

OUTPUT = Path(__file__).resolve().parent.parent / "docs" / "images" / "photos_to_asset.jpg"
SIDE = 300
PAPER = np.array([246, 245, 242], np.float32) / 255


def relit_by(run: FinishedRun, plugins: PluginManager, split: str) -> EnvironmentMap:
    """The light that a split of the run's capture names, in the run's working frame."""
    capture = run.read_split(run.capture_path, split, plugins)
    if capture.environment is None:
        raise SystemExit(f"{run.capture_path}: split {split} names no light")
    return load_light(capture.environment, capture.world_from_source)


def main(run_folder: str, split: str) -> None:
    """Writes the picture."""
    import torch

    plugins = PluginManager.discover()
    run = open_finished_run(open_run(run_folder))
    capture = run.views_of_split(run.capture_path, "train", plugins)
    _, renderer = reference_renderer(plugins, options={"render_samples": 128}, bounces=run.bounces)
    photographs = [masked_photograph(capture.views[i]) for i in evenly_spaced_indices(len(capture.views), 4)]
    tiles = [_on_paper(photo.color_linear, photo.mask) for photo in photographs]
    quarters = [
        np.asarray(Image.fromarray(_codes(t)).resize((SIDE // 2, SIDE // 2), Image.Resampling.LANCZOS)) for t in tiles
    ]
    photos = np.vstack([np.hstack(quarters[:2]), np.hstack(quarters[2:])])

    camera = orbit_cameras(7, 22.0, SIDE)[1]
    material = run.scene.material
    assert material is not None
    grey = Material("paper", torch.full((3,), 0.6), torch.zeros(3), torch.ones(1))
    white = replace(run.scene.environment, radiance=torch.ones_like(run.scene.environment.radiance), to_world=None)  # type: ignore[type-var]
    other = relit_by(run, plugins, split)
    plain = replace(other, radiance=other.radiance.mean(dim=2, keepdim=True).expand_as(other.radiance).contiguous())
    flat = replace(material, model="paper", specular_albedo=torch.zeros(3))
    shots: dict[str, Scene] = {
        "mesh": replace(run.scene, material=grey, environment=plain),
        "albedo": replace(run.scene, material=flat, environment=white),
        "fitted light": run.scene,
        "another light": run.with_light(other),
    }
    pictures = {
        name: _codes(_on_paper(*unassociate(render_view(renderer, s, camera, name)))) for name, s in shots.items()
    }
    _write({"photographs": photos} | pictures)


def _on_paper(color: np.ndarray, mask: np.ndarray) -> np.ndarray:
    return np.asarray(composite(color, mask) + PAPER * (1 - mask[..., None]), dtype=np.float32)


def _codes(picture: np.ndarray) -> np.ndarray:
    return np.round(np.clip(picture, 0, 1) * 255).astype(np.uint8)


def _write(pictures: dict[str, np.ndarray]) -> None:
    gap, caption = 12, 28
    width = len(pictures) * SIDE + (len(pictures) - 1) * gap
    sheet = Image.new("RGB", (width, SIDE + caption), tuple(int(c) for c in PAPER * 255))
    draw = ImageDraw.Draw(sheet)
    for i, (name, picture) in enumerate(pictures.items()):
        left = i * (SIDE + gap)
        sheet.paste(Image.fromarray(picture), (left, 0))
        draw.text(
            (left + SIDE // 2, SIDE + caption // 2),
            name,
            fill=(90, 92, 98),
            font=ImageFont.load_default(15),
            anchor="mm",
        )
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(OUTPUT, quality=90)


if __name__ == "__main__":
    main(*sys.argv[1:3])
