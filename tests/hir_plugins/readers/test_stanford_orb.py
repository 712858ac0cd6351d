"""The layout of Stanford-ORB's blender_LDR and blender_HDR: masks in train_mask, LDR as PNG or HDR as EXR."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.textures.image_files import write_exr, write_png

from hir_core.plugins import NoOptions
from hir_plugins.readers.transforms_json import TransformsJsonReader

WIDTH, HEIGHT = 64, 48


def scene(folder: Path, suffix: str) -> Path:
    """One train and one test view of 64×48, one bright pixel each; the mask covers the pixel's quarter."""
    # OpenGL's camera at z = 5 of a world with +Z up, looking down: the point lies right of and above the middle
    pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 5], [0, 0, 0, 1]]
    for split in ("train", "test"):
        (folder / split).mkdir(parents=True)
        (folder / f"{split}_mask").mkdir()
        picture = np.full((HEIGHT, WIDTH, 3), 0.05, np.float32)
        picture[12, 40] = 4.0 if suffix == "exr" else 1.0
        mask = np.zeros((HEIGHT, WIDTH, 3), np.float32)
        mask[:24, 32:] = 1
        write = write_exr if suffix == "exr" else write_png
        write(folder / split / f"0000.{suffix}", picture)
        write_png(folder / f"{split}_mask" / "0000.png", mask)
        frames = [{"file_path": f"{split}/0000", "transform_matrix": pose}]
        content = {"camera_angle_x": 2 * math.atan(0.5 * WIDTH / 80), "frames": frames}
        (folder / f"transforms_{split}.json").write_text(json.dumps(content))
    return folder


@pytest.mark.parametrize("suffix", ["png", "exr"])
def test_pixels_and_masks_come_from_their_folders(tmp_path: Path, suffix: str) -> None:
    folder = scene(tmp_path / "teapot_scene001", suffix)
    reader = TransformsJsonReader(NoOptions())
    assert reader.matches(folder) and reader.splits(folder) == ["train", "test"]
    view = reader.read(folder, "train").views[0]
    assert view.camera is not None
    world = reader.read(folder).world_from_source @ [8.5 / 16, 11.5 / 16, 0, 1]
    pixel, depth = view.camera.project(world[None, :3])
    np.testing.assert_allclose(pixel, [[40.5, 12.5]], atol=1e-9)
    assert depth[0] == pytest.approx(5)
    pixels = view.pixels()
    assert np.argwhere(pixels.color_linear[..., 0] > 0.5).tolist() == [[12, 40]]
    # HDR pictures keep what an LDR one clips
    assert pixels.color_linear[12, 40, 0] == pytest.approx(4.0 if suffix == "exr" else 1.0, rel=1e-3)
    assert pixels.mask is not None
    assert pixels.mask[:24, 32:].min() == 1 and pixels.mask[24:].max() == 0 and pixels.mask[:, :32].max() == 0
