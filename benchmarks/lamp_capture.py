"""Renders an object of the materials benchmark under a lamp that the camera carries, from different distances.

    python -m benchmarks.lamp_capture 28_vase_matt_lamps OUTPUT [--room overcast] [--lamp 12] [--ratio 2]
    hir reconstruct OUTPUT -o RUN
    hir evaluate RUN

Mitsuba's path tracer, `principled` and point emitter. The room's light stands still, and all photographs have one
exposure.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from hir_exporters.textures.image_files import write_png
from numpy.typing import NDArray

from benchmarks.materials.lights import LIGHTS, light_image
from benchmarks.materials.materials import MATERIALS
from benchmarks.materials.recipes import recipes
from benchmarks.materials.render import (
    DISTANCE,
    FIELD_OF_VIEW,
    bright_value,
    encoded,
    mitsuba_mesh,
    render_view,
    spiral_camera,
    write_obj,
)
from benchmarks.materials.shapes import make_shape

VIEWS = {"train": 40, "test": 8}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recipe", choices=[each.name for each in recipes()], metavar="RECIPE")
    parser.add_argument("output", type=Path)
    parser.add_argument(
        "--room", choices=[name for name in LIGHTS if LIGHTS[name].frame == "world"], default="overcast"
    )
    parser.add_argument("--lamp", type=float, default=12.0, help="0 for none; 12 lights the object like the room")
    parser.add_argument("--ratio", type=float, default=2.0, help="of the largest distance to the smallest")
    parser.add_argument("--side", type=int, default=192, help="pixels of a photograph")
    parser.add_argument("--samples", type=int, default=128, help="paths for each pixel")
    parser.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba's variant")
    given = parser.parse_args()
    import mitsuba as mi

    mi.set_variant(given.variant)
    recipe = next(each for each in recipes() if each.name == given.recipe)
    shape, rng = make_shape(recipe.shape), np.random.default_rng(recipe.seed)
    surface = MATERIALS[recipe.material].draw(shape.positions.astype(np.float64), shape.parts, rng)
    mesh, room = mitsuba_mesh(mi, shape, surface), light_image(given.room, rng)
    given.output.mkdir(parents=True)
    write_obj(given.output / "reference.obj", shape)
    strength = 0.0
    for split, count in VIEWS.items():
        poses = [_at_distance(spiral_camera(i, count, split), _factor(i, given.ratio)) for i in range(count)]
        renders = [
            render_view(mi, mesh, surface, room, False, given.lamp, pose, given.side, given.samples, i)
            for i, pose in enumerate(poses)
        ]
        strength = strength or recipe.exposure / bright_value(renders)
        (given.output / split).mkdir()
        for i, image in enumerate(renders):
            write_png(given.output / split / f"{i:03d}.png", encoded(image, strength))
        frames = [{"file_path": f"./{split}/{i:03d}", "transform_matrix": p.tolist()} for i, p in enumerate(poses)]
        document = {"camera_angle_x": FIELD_OF_VIEW, "frames": frames}
        (given.output / f"transforms_{split}.json").write_text(json.dumps(document, indent=1))


def _factor(i: int, ratio: float) -> float:
    """Of a view's distance, 1 to `ratio`, even in the logarithm."""
    return float(ratio ** ((i * 0.754878) % 1))


def _at_distance(pose: NDArray[np.float64], factor: float) -> NDArray[np.float64]:
    moved = pose.copy()
    moved[:3, 3] *= factor
    assert np.isclose(np.linalg.norm(moved[:3, 3]), factor * DISTANCE)
    return moved


if __name__ == "__main__":
    main()
