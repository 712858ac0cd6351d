"""Depth by COLMAP's PatchMatch (Schönberger et al. 2016); needs a COLMAP built with CUDA."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pycolmap
import torch
from hir_exporters.conventions import linear_to_srgb

from hir_core.capture import Array, Camera
from hir_core.errors import StageError
from hir_plugins.initializers.sfm.feature_matching import run_cancellable
from hir_plugins.initializers.stereo.depth_consistency import DepthMap
from hir_plugins.initializers.stereo.stereo_photographs import StereoPhotograph

MAX_NEIGHBOURS = 10
"""Maximum number of photographs that each one is compared with; COLMAP selects among them at each pixel."""


def patch_match_available() -> bool:
    """Whether this COLMAP was built with CUDA."""
    return bool(pycolmap.has_cuda)


def patch_match(
    photographs: Sequence[StereoPhotograph], near: Sequence[Sequence[int]], center: Array, radius: float, folder: Path
) -> list[DepthMap]:
    """Depth of each photograph, checked for geometric consistency; `near` names the neighbours of each.

    A photograph without neighbours, such as the only one of its take, has no depth.

    The sphere of `center` and `radius` bounds the depth range. COLMAP's workspace is written below `folder`.
    """
    if not any(near):
        return [_empty_map(photograph) for photograph in photographs]
    workspace = write_workspace(photographs, near, folder / "patch_match")
    options = pycolmap.PatchMatchOptions()
    distances = [np.linalg.norm(p.camera.center - center) for p in photographs]
    options.depth_min = float(max(min(distances) - 1.1 * radius, 1e-3 * min(distances)))
    options.depth_max = float(max(distances) + 1.1 * radius)
    options.geom_consistency = True
    run_cancellable(
        lambda token: pycolmap.patch_match_stereo(str(workspace), options=options, cancellation_token=token)
    )
    return [
        read_depth(workspace, index, photograph) if near[index] else _empty_map(photograph)
        for index, photograph in enumerate(photographs)
    ]


def write_workspace(photographs: Sequence[StereoPhotograph], near: Sequence[Sequence[int]], workspace: Path) -> Path:
    """A workspace for COLMAP's dense stereo: undistorted images, a model, and the neighbours of each image."""
    from PIL import Image

    shutil.rmtree(workspace, ignore_errors=True)
    for name in ("images", "sparse", "stereo/depth_maps", "stereo/normal_maps", "stereo/consistency_graphs"):
        (workspace / name).mkdir(parents=True)
    model = pycolmap.Reconstruction()
    for index, photograph in enumerate(photographs):
        encoded = np.rint(np.clip(linear_to_srgb(photograph.color_linear), 0, 1) * 255).astype(np.uint8)
        Image.fromarray(encoded).save(workspace / "images" / _name(index))
        _add(model, index, photograph.camera)
    model.write(str(workspace / "sparse"))
    lines = []
    for index, others in enumerate(near):
        if others:  # COLMAP skips an empty line, and would read the next name as a list of neighbours
            lines += [_name(index), ", ".join(_name(j) for j in others[:MAX_NEIGHBOURS])]
    (workspace / "stereo" / "patch-match.cfg").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return workspace


def read_depth(workspace: Path, index: int, photograph: StereoPhotograph) -> DepthMap:
    """COLMAP's geometrically consistent depth as a `DepthMap` of weight 1, empty outside the mask."""
    path = workspace / "stereo" / "depth_maps" / f"{_name(index)}.geometric.bin"
    if not path.is_file():
        raise StageError(f"COLMAP's PatchMatch left no {path.name}; see its messages above")
    stored = pycolmap.DepthMap()
    stored.read(str(path))
    depth = np.asarray(stored.to_array(), dtype=np.float32)
    height, width = photograph.color_linear.shape[:2]
    if depth.shape != (height, width):
        raise StageError(f"{path} is {depth.shape[1]}×{depth.shape[0]}, its photograph {width}×{height}")
    known = (depth > 0) & np.isfinite(depth) & (photograph.inside > 0.5)
    inverse = torch.from_numpy(np.where(known, 1 / np.where(known, depth, 1), 0).astype(np.float32))
    return DepthMap(photograph.camera, inverse, (inverse > 0).float())


def _empty_map(photograph: StereoPhotograph) -> DepthMap:
    unknown = torch.zeros(photograph.inside.shape)
    return DepthMap(photograph.camera, unknown, unknown)


def _name(index: int) -> str:
    return f"{index:05d}.png"


def _add(model: pycolmap.Reconstruction, index: int, camera: Camera) -> None:
    k = camera.intrinsics
    lens = pycolmap.Camera(
        model="PINHOLE",
        width=camera.width,
        height=camera.height,
        params=[k[0, 0], k[1, 1], k[0, 2], k[1, 2]],
        camera_id=index + 1,
    )
    model.add_camera_with_trivial_rig(lens)
    image = pycolmap.Image(name=_name(index), camera_id=index + 1, image_id=index + 1)
    pose = np.ascontiguousarray(camera.world_to_camera[:3], dtype=np.float64)
    model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose))
