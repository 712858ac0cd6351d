"""Renders a capture of the materials benchmark again, with the card of `hir card` lying beside the object.

    python -m benchmarks.materials make MATERIALS --only NN
    python -m benchmarks.card_capture MATERIALS/HALF/NAME OUTPUT [--side 640]
    hir reconstruct OUTPUT -o RUN --set initializer.fiducial_markers.side=0.05

With `--chart` a ColorChecker lies in place of the card, and `hir reconstruct` needs no setting.
Training photographs show object, card and surroundings, with a mask of the object; the other splits are those of the
capture. The card's paper has a reflectance of 0.85; how dark its greys are printed is not told.
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from hir_exporters.conventions import linear_to_srgb
from hir_exporters.textures.image_files import read_hdr, write_png
from numpy.typing import NDArray

from benchmarks.materials.lights import LIGHTS
from benchmarks.materials.materials import MATERIALS
from benchmarks.materials.recipes import recipes
from benchmarks.materials.render import DEPTH, LATLONG_TO_WORLD, bright_value, mitsuba_mesh, sensor, spiral_camera
from benchmarks.materials.shapes import make_shape
from hir_plugins.initializers.color_chart.chart_views import ColorCheckerSheet
from hir_plugins.initializers.markers.grey_card import GreyCard

MARKER_SIDE = 0.4
"""Of a marker or of a patch of the chart; in the capture's unit, about the object's radius."""
FIELD_OF_VIEW = 1.15
SPIRAL_VIEWS = 40
"""Of the spiral of the materials benchmark. Those from below the card are left out, which would hide the object."""
PAPER, INK = 0.85, 0.03
CENTER = (1.75, 0.0)
"""Of the card; the object stands at the origin."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--chart", action="store_true", help="a ColorChecker in place of the card")
    parser.add_argument("--side", type=int, default=640, help="pixels of a photograph")
    parser.add_argument("--samples", type=int, default=48, help="paths for each pixel")
    parser.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba's variant")
    given = parser.parse_args()
    import mitsuba as mi

    mi.set_variant(given.variant)
    shutil.copytree(given.capture, given.output, ignore=shutil.ignore_patterns("train", "transforms_train.json"))
    recipe = next(each for each in recipes() if each.name == given.capture.resolve().name)
    if LIGHTS[recipe.light].frame != "world":
        raise SystemExit(f"the light of {recipe.name} is carried by the camera; take another capture")
    shape = make_shape(recipe.shape)
    surface = MATERIALS[recipe.material].draw(
        shape.positions.astype(np.float64), shape.parts, np.random.default_rng(recipe.seed)
    )
    mesh, floor = mitsuba_mesh(mi, shape, surface), float(shape.positions[:, 2].min())
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": DEPTH},
        "object": mesh,
        "card": _card(mi, floor, given.chart),
        "light": {
            "type": "envmap",
            "bitmap": mi.Bitmap(read_hdr(given.output / "env_train.hdr")),
            "to_world": mi.ScalarTransform4f(np.array(LATLONG_TO_WORLD, dtype=np.float64)),
        },
    }
    spiral = [spiral_camera(i, SPIRAL_VIEWS, "train") for i in range(SPIRAL_VIEWS)]
    poses = [pose for pose in spiral if pose[2, 3] > floor]
    renders, masks = [], []
    for i, pose in enumerate(poses):
        camera = sensor(mi, pose, given.side, given.samples, FIELD_OF_VIEW)
        renders.append(_render(mi, scene | {"sensor": camera}, given.samples, i)[..., :3])
        alone = {"type": "scene", "integrator": {"type": "direct"}, "object": mesh, "sensor": camera}
        masks.append(_render(mi, alone, 32, i)[..., 3:].clip(0, 1))
    strength = json.loads((given.output / "transforms_test.json").read_text())["environment"]["strength"]
    own = recipe.exposure / bright_value([np.concatenate(pair, axis=2) for pair in zip(renders, masks, strict=True)])
    print(f"strength {strength:.3f}; the card's photographs alone would have {own:.3f}")
    for folder in ("train", "train_mask"):
        (given.output / folder).mkdir()
    for i, (image, mask) in enumerate(zip(renders, masks, strict=True)):
        write_png(given.output / "train" / f"{i:03d}.png", linear_to_srgb((image * strength).clip(0, 1)))
        write_png(given.output / "train_mask" / f"{i:03d}.png", np.repeat(mask, 3, axis=2).astype(np.float32))
    frames = [{"file_path": f"./train/{i:03d}.png", "transform_matrix": p.tolist()} for i, p in enumerate(poses)]
    (given.output / "transforms_train.json").write_text(
        json.dumps({"camera_angle_x": FIELD_OF_VIEW, "frames": frames}, indent=1)
    )


def _card(mi: Any, floor: float, is_chart: bool) -> dict[str, Any]:
    """A rectangle at the height of the object's lowest point, printed side up."""
    sheet = ColorCheckerSheet(MARKER_SIDE) if is_chart else GreyCard(MARKER_SIDE)
    picture = sheet.picture(128 / MARKER_SIDE)[::-1]  # v of a rectangle grows upwards
    if not is_chart:
        picture = np.repeat((INK + (PAPER - INK) * (picture / 255.0) ** 1.8)[..., None], 3, axis=2)
    transform, (width, height) = mi.ScalarTransform4f, sheet.size
    to_world = transform().translate([CENTER[0], CENTER[1], floor]) @ transform().scale([width / 2, height / 2, 1])
    texture = {
        "type": "bitmap",
        "bitmap": mi.Bitmap(np.ascontiguousarray(picture, np.float32)),
        "raw": True,
        "filter_type": "bilinear",
    }
    # the table under the card is the card's own back: two-sided, so that it throws light neither way
    return {
        "type": "rectangle",
        "to_world": to_world,
        "bsdf": {"type": "twosided", "nested": {"type": "diffuse", "reflectance": texture}},
    }


def _render(mi: Any, scene: dict[str, Any], samples: int, seed: int) -> NDArray[np.float32]:
    return np.nan_to_num(np.array(mi.render(mi.load_dict(scene), spp=samples, seed=seed)).astype(np.float32))


if __name__ == "__main__":
    main()
