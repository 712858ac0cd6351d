"""The axes of a glTF scan, found by the agreement of the photographs about the colours of its surface.

glTF is +Y up, and programs whose projects are +Z up turn a mesh when they write it; some write it as it is. Readers
whose files define no up direction turn the project's world upright by an angle that the scan does not know
(`parsing/upright.py`). So a glTF may be meant in three ways.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from hir_exporters.conventions import Z_UP_TO_Y_UP, linear_to_srgb
from numpy.typing import NDArray

from hir_core.capture import Array, Camera, Capture, View
from hir_plugins.initializers.surface.silhouette_fields import working_downsample
from hir_plugins.initializers.surface.vertex_colors import VertexVisibility, colors_at, vertex_normals

SOURCE_FROM_Y_UP: Final = np.eye(4)
"""From glTF's axes to those of a project that is +Z up."""
SOURCE_FROM_Y_UP[:3, :3] = Z_UP_TO_Y_UP.T
SOURCE_FROM_Y_UP.setflags(write=False)

MAX_VERTICES = 4000
MAX_VIEWS = 24
"""Vertices and photographs that are compared, spread over all."""
MIN_VIEWS_OF_VERTEX = 3
MIN_VERTICES = 50
"""Fewer compared vertices give no figure."""
CLEAR_RATIO = 0.8
"""The smallest disagreement is clear where it is below this share of the next one."""


@dataclass(frozen=True)
class AxesComparison:
    """The axes that were chosen, and the disagreement of the photographs for each."""

    axes: str
    disagreement: Mapping[str, float]
    """Mean deviation of a vertex's colours from their median, relative to that of all colours; infinite where the
    photographs show too few vertices."""
    clear: bool


def world_from_axes(axes: str, capture: Capture) -> Array:
    """4×4 matrix to the world of the capture from `world`, `source` or `source_y_up` (`MeshFileOptions.axes`)."""
    if axes == "world":
        return np.eye(4)
    return capture.world_from_source if axes == "source" else capture.world_from_source @ SOURCE_FROM_Y_UP


def axes_of_gltf(positions: Array, faces: NDArray[np.int64], capture: Capture) -> AxesComparison:
    """The axes of a glTF mesh, positions (V, 3) as in the file.

    `world` without a comparison where a project that is +Z up means the same, and without photographs with cameras. A
    comparison that is not clear takes the first of `source_y_up`, `world`, `source`, with a warning.
    """
    candidates = {axes: world_from_axes(axes, capture) for axes in ("source_y_up", "world", "source")}
    views = compared_views(capture)
    if not views or np.allclose(candidates["source_y_up"], candidates["world"], atol=1e-6):
        return AxesComparison("world", {}, True)
    vertices = _evenly_spaced(len(positions), MAX_VERTICES)
    visibility = VertexVisibility(positions, faces, vertex_normals(positions, faces)).among(vertices)
    factor = working_downsample(capture)
    images = [linear_to_srgb(np.clip(view.pixels(factor).color_linear, 0, 1)).astype(np.float32) for view in views]
    cameras = [view.camera.downsampled(factor) for view in views if view.camera is not None]
    found = {
        axes: colour_disagreement(
            visibility, [camera.transformed(np.linalg.inv(to_world)) for camera in cameras], images
        )
        for axes, to_world in candidates.items()
    }
    best = min(found.values())
    near = [axes for axes, value in found.items() if CLEAR_RATIO * value <= best]
    if len(near) > 1 and np.isfinite(best):
        warnings.warn(
            f"the photographs do not show which axes the scan has ({', '.join(near)} fit as well); {near[0]} is taken; "
            "--set initializer.mesh_file.axes (--axes of hir delight) chooses",
            stacklevel=3,
        )
    if not np.isfinite(best):
        warnings.warn(
            "the photographs show too little of the scan in any axes that it may have; export it from the project of "
            "the cameras, or move it onto their points with --align (initializer.mesh_file.align)",
            stacklevel=3,
        )
    return AxesComparison(near[0], {axes: round(value, 4) for axes, value in found.items()}, len(near) == 1)


def compared_views(capture: Capture) -> list[View]:
    """Photographs with cameras of the take that has most of them, spread over it."""
    posed = [view for view in capture.views if view.camera is not None]
    largest = Counter(view.take for view in posed).most_common(1)
    members = [view for view in posed if view.take == largest[0][0]]
    return [members[i] for i in _evenly_spaced(len(members), MAX_VIEWS)]


def colour_disagreement(
    visibility: VertexVisibility, cameras: Sequence[Camera], images: Sequence[NDArray[np.float32]]
) -> float:
    """Mean absolute deviation of a vertex's colours from their median, divided by that of all colours from theirs.

    Images are (H, W, 3), cameras in the axes of the mesh. 1 where the photographs show something else than the mesh;
    infinite where fewer than `MIN_VERTICES` vertices are seen by `MIN_VIEWS_OF_VERTEX` photographs.
    """
    rows = []
    for camera, image in zip(cameras, images, strict=True):
        visible, _, pixels = visibility.from_camera(camera)
        row = np.full((len(visible), 3), np.nan)
        row[visible] = colors_at(image, pixels[visible])
        rows.append(row)
    colors = np.stack(rows)
    colors = colors[:, np.isfinite(colors[..., 0]).sum(axis=0) >= MIN_VIEWS_OF_VERTEX]
    if colors.shape[1] < MIN_VERTICES:
        return float("inf")
    within = np.nanmean(np.abs(colors - np.nanmedian(colors, axis=0)))
    seen = colors[np.isfinite(colors[..., 0])]
    overall = np.abs(seen - np.median(seen, axis=0)).mean()
    return float(within / max(overall, 1e-6))


def _evenly_spaced(count: int, limit: int) -> NDArray[np.int64]:
    """Indices of at most `limit` of `count` elements, evenly spaced."""
    return np.unique(np.linspace(0, max(count - 1, 0), min(count, limit)).round().astype(np.int64))
