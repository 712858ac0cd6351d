"""A scan as it was before a run: its mesh with its own texture, unlit or under a light."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from hir_exporters.conventions import srgb_to_linear
from numpy.typing import NDArray

from hir_core.scene import EnvironmentMap, Material, Scene, Texture
from hir_core.scene.scan import load_scan
from hir_core.scene.scene_store import load_stage_scene

TEXTURE_ONLY_F0, TEXTURE_ONLY_ALPHA = 0.04, 0.25
"""What a texture without other maps is usually given: a dielectric of roughness 0.5, which is α = 0.25."""

TEXTURE_SIDE = 4096
"""Longest side of a texture that is rendered; larger ones are reduced, which pictures of a report do not show."""


def textured_scan(initializer: Path, light: EnvironmentMap | None = None, device: str = "cpu") -> Scene | None:
    """The scan of a run in the working frame, from the folder of its initializer stage.

    None where the surface was no scan, or one without a texture that could be read.
    """
    scan = load_scan(initializer)
    if scan is None or scan.texture is None:
        return None
    mesh = load_stage_scene(initializer / "scene", "cpu").mesh
    albedo = torch.from_numpy(linear_reduced(scan.texture, TEXTURE_SIDE))
    return Scene(mesh, texture_as_material(albedo), light).to(device)


def texture_as_material(albedo: Texture) -> Material:
    """The material as which engines show a linear texture that has no other maps."""
    return Material(
        "dielectric",
        albedo.clamp(0, 1),
        albedo.new_full((3,), TEXTURE_ONLY_F0),
        albedo.new_full((1,), TEXTURE_ONLY_ALPHA),
    )


def linear_reduced(codes: NDArray[np.uint8], side: int) -> NDArray[np.float32]:
    """Linear (H, W, C) of sRGB codes, each texel the mean of a block, with at most `side` texels per side.

    A border that fills no block is cut.
    """
    linear = srgb_to_linear(np.arange(256, dtype=np.float32) / 255)
    factor = min(-(-max(codes.shape[:2]) // side), *codes.shape[:2])
    height, width = (length // factor for length in codes.shape[:2])
    total = np.zeros((height, width, codes.shape[2]), np.float32)
    for row in range(factor):
        for column in range(factor):
            total += linear[codes[row : height * factor : factor, column : width * factor : factor]]
    return np.asarray(total / factor**2, np.float32)
