"""Noise of the benchmark's photographs: the PSNR that no fit can exceed.

Photographs are path traced, so each pixel has an error of its own. A perfect model differs from a photograph by that
error alone.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from hir_exporters.conventions import srgb_to_linear
from hir_exporters.textures.image_files import read_hdr, read_ldr
from numpy.typing import NDArray

from benchmarks.materials.lights import LIGHTS
from benchmarks.materials.recipes import Recipe
from benchmarks.materials.render import SAMPLES, SIDE, SPLITS, encoded, render_view, scene_parts, spiral_camera
from benchmarks.materials.shapes import Shape, make_shape
from benchmarks.stored_rows import provenance

OTHER_SEED = 1_000_003
"""Added to the seed of a photograph for a second one of the same view."""
INDEPENDENT_DB = 10 * np.log10(2)
"""Two photographs differ by twice the variance of one."""


def noise_ceiling(mi: Any, recipe: Recipe, shape: Shape, folder: Path, views: int) -> float:
    """PSNR over the object between photographs of the test split and their expectation, in dB; a mean over views.

    Each view is rendered once more with other random numbers.
    """
    mesh, surface, _ = scene_parts(mi, recipe, shape)
    light, light_map = LIGHTS[recipe.light], read_hdr(folder / "env_train.hdr")
    found = []
    for i in range(0, SPLITS["test"], max(1, SPLITS["test"] // views)):
        pose = spiral_camera(i, SPLITS["test"], "test")
        carried = light.frame == "camera"
        again = render_view(mi, mesh, surface, light_map, carried, light.lamp, pose, SIDE, SAMPLES, i + OTHER_SEED)
        found.append(_ceiling(np.asarray(read_ldr(folder / "test" / f"{i:03d}.png"), np.float32), again))
    return float(np.mean(found))


def _ceiling(photograph: NDArray[np.float32], again: NDArray[np.float32]) -> float:
    """Of one view: `photograph` sRGB with alpha, `again` premultiplied linear."""
    inside = (photograph[..., 3] > 0.5) & (again[..., 3] > 0.5)
    strength = _strength(photograph, again, inside)
    error = photograph[..., :3] - encoded(again, strength)[..., :3]
    return float(-10 * np.log10(np.square(error[inside]).mean()) + INDEPENDENT_DB)


def _strength(photograph: NDArray[np.float32], again: NDArray[np.float32], inside: NDArray[np.bool_]) -> float:
    """The factor between linear render and photograph, from the pixels that are not clipped."""
    unclipped = inside & (photograph[..., :3].max(axis=-1) < 0.99)
    color = again[..., :3] / np.maximum(again[..., 3:], 1e-3)
    return float(srgb_to_linear(photograph[..., :3])[unclipped].sum() / max(color[unclipped].sum(), 1e-12))


def print_noise(captures: Path, chosen: Sequence[Recipe], views: int) -> bool:
    """One line of JSON for each capture that is rendered: its ceiling. Whether there is one."""
    import mitsuba as mi

    about = provenance()
    rendered = [r for r in chosen if (captures / r.half / r.name / "truth.json").exists()]
    for recipe in rendered:
        folder = captures / recipe.half / recipe.name
        ceiling = noise_ceiling(mi, recipe, make_shape(recipe.shape), folder, views)
        row = {"capture": recipe.name, "half": recipe.half, "views": views, "ceiling_db": round(ceiling, 2)}
        print(json.dumps(row | about), flush=True)
    return bool(rendered)
