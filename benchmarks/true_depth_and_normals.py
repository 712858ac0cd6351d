"""Errors of normals and depth against the true ones that NeRF-synthetic captures store for their test views.

`*_normal_0000.png` is the normal in world axes, components below zero clipped, so that only normals without a negative
component are known; `*_depth_0000.png` the distance along the ray, `8 · (1 − value)`, in 8 bits: steps of 0.03.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from hir_exporters.conventions import srgb_to_linear
from PIL import Image

from hir_core.capture import Capture
from hir_core.scene import Mesh

FAR_DISTANCE = 8.0
MIN_NORMAL_COMPONENT = 0.12
"""Normals with a smaller component are ignored: it may have been clipped."""


@dataclass(frozen=True)
class PictureErrors:
    """Over the pixels of all test views where mesh and truth both show the object."""

    normal_degrees: float
    """Median angle between the normals."""
    depth: float
    """Mean absolute difference, in the world's unit."""


def picture_errors(mesh: Mesh, test: Capture) -> PictureErrors | None:
    """None for captures without such pictures."""
    import open3d

    scene = open3d.t.geometry.RaycastingScene()
    positions = mesh.positions.detach().numpy()
    scene.add_triangles(positions.astype(np.float32), mesh.faces.numpy().astype(np.uint32))
    source_from_world = np.linalg.inv(test.world_from_source)
    scale = float(np.cbrt(np.linalg.det(test.world_from_source[:3, :3])))
    angles, depths = [], []
    for view, camera in zip(test.views, test.cameras, strict=True):
        assert view.path is not None
        beside = [view.path.with_name(f"{view.path.stem}_{kind}_0000.png") for kind in ("normal", "depth")]
        if not all(path.is_file() for path in beside):
            return None
        normal_image, depth_image = (np.asarray(Image.open(path)) for path in beside)
        rows, columns = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
        origin, direction = camera.rays(np.stack([columns, rows], axis=-1).reshape(-1, 2))
        rays = np.concatenate([np.broadcast_to(origin, direction.shape), direction], axis=1).astype(np.float32)
        hit = scene.cast_rays(open3d.core.Tensor(rays))
        distance, normal = hit["t_hit"].numpy(), hit["primitive_normals"].numpy()
        value = depth_image.reshape(-1, depth_image.shape[-1] if depth_image.ndim == 3 else 1)[:, 0]
        mask = view.pixels().mask
        assert mask is not None
        both = (mask.reshape(-1) > 0.99) & np.isfinite(distance) & (value > 0)
        depths.append(np.abs(distance[both] - scale * FAR_DISTANCE * (1 - value[both] / 255)))
        true = srgb_to_linear(normal_image[..., :3].reshape(-1, 3) / 255)
        known = both & (true.min(axis=1) > MIN_NORMAL_COMPONENT)
        turned = normal[known] @ source_from_world[:3, :3].T
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        true = true[known] / np.linalg.norm(true[known], axis=1, keepdims=True)
        angles.append(np.degrees(np.arccos(np.clip((turned * true).sum(axis=1), -1, 1))))
    return PictureErrors(float(np.median(np.concatenate(angles))), float(np.concatenate(depths).mean()))
