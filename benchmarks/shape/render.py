"""Renders the captures of the shape benchmark: photographs with alpha, cameras, and the true mesh."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
from hir_exporters.textures.image_files import write_png

from benchmarks.materials.lights import light_image
from benchmarks.materials.render import (
    FIELD_OF_VIEW,
    bright_value,
    encoded,
    mitsuba_mesh,
    render_view,
    spiral_camera,
    write_obj,
)
from benchmarks.materials.shapes import Shape, mesh_of_parts
from benchmarks.shape.materials import draw_surface
from benchmarks.shape.recipes import Recipe
from benchmarks.shape.shapes import OBJECTS

SIDE, VIEWS, SAMPLES = 256, 40, 48
EXPOSURE = 0.9
"""Linear value that the brightest 2 % of object pixels reach."""
RESOLUTION = 192
"""Cells of the sampling grid along each axis: an edge of the mesh is about 1.3 pixels long."""


def true_shape(name: str, resolution: int = RESOLUTION) -> Shape:
    """The mesh of an object."""
    return mesh_of_parts(OBJECTS[name].parts(), resolution)


def write_capture(
    recipe: Recipe,
    folder: Path,
    side: int = SIDE,
    views: int = VIEWS,
    samples: int = SAMPLES,
    shape: Shape | None = None,
) -> None:
    """Writes one capture; `truth.json` is written last, so a folder with it is complete."""
    import mitsuba as mi

    rng = np.random.default_rng(recipe.seed)
    shape = shape or true_shape(recipe.object)
    surface = draw_surface(recipe.material, shape.positions.astype(np.float64), rng)
    mesh = mitsuba_mesh(mi, shape, surface)
    light = light_image(recipe.light, rng)
    poses = [spiral_camera(i, views, "train") for i in range(views)]
    renders = [
        render_view(mi, mesh, surface, light, False, 0.0, pose, side, samples, i) for i, pose in enumerate(poses)
    ]
    strength = EXPOSURE / bright_value(renders)
    (folder / "train").mkdir(parents=True, exist_ok=True)
    write_obj(folder / "reference.obj", shape)
    for i, image in enumerate(renders):
        write_png(folder / "train" / f"{i:03d}.png", encoded(image, strength))
    frames = [{"file_path": f"./train/{i:03d}", "transform_matrix": pose.tolist()} for i, pose in enumerate(poses)]
    document = {"camera_angle_x": FIELD_OF_VIEW, "frames": frames}
    (folder / "transforms_train.json").write_text(json.dumps(document, indent=1))
    (folder / "truth.json").write_text(json.dumps(asdict(recipe), indent=1))
