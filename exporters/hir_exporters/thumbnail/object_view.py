"""A camera that shows the whole object, and the surface points in its pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import AssetMesh
from hir_exporters.textures.uv_rasterization import rasterize_triangles

Array = NDArray[np.float64]

_AZIMUTH_RAD, _ELEVATION_RAD = np.radians(30.0), np.radians(20.0)
"""From +Z, which is the front of an asset in glTF, towards +X, and upwards."""

_HALF_FIELD_OF_VIEW_RAD: Final = np.radians(15.0)

_FILL: Final = 0.9
"""Share of the picture's side that the object's longer side takes."""


def camera_to_world() -> Array:
    """Rotation (3, 3) of the camera: its columns are right, down and forward in world axes (OpenCV)."""
    horizontal = np.cos(_ELEVATION_RAD)
    backward = np.array([horizontal * np.sin(_AZIMUTH_RAD), np.sin(_ELEVATION_RAD), horizontal * np.cos(_AZIMUTH_RAD)])
    right = np.array([np.cos(_AZIMUTH_RAD), 0.0, -np.sin(_AZIMUTH_RAD)])
    return np.stack([right, -np.cross(backward, right), -backward], axis=-1)


@dataclass(frozen=True, eq=False)
class ObjectView:
    """The N pixels of a square picture that show the object."""

    pixels: NDArray[np.int64]
    """(N,) row * side + column."""
    corners: NDArray[np.int32]
    """(N, 3) vertices of the triangle in each pixel."""
    normals: Array
    """(N, 3) smooth normals in world axes, towards the camera's side of the triangle; unit or 0."""
    views: Array
    """(N, 3) unit directions towards the camera."""
    uvs: Array
    """(N, 2) texture coordinates in [0, 1)."""


def object_view(mesh: AssetMesh, side: int) -> ObjectView:
    """The view in perspective. Triangles that face away are not drawn, as in engines, unless all of them do."""
    rotation = camera_to_world()
    positions = mesh.positions.astype(np.float64)
    center = (positions.min(axis=0) + positions.max(axis=0)) / 2
    radius = max(float(np.linalg.norm(positions - center, axis=1).max()), 1e-30)
    scaled = (positions - center) / radius
    camera = -rotation[:, 2] / np.sin(_HALF_FIELD_OF_VIEW_RAD)  # outside of the unit sphere around the object
    local = np.einsum("vi,ij->vj", scaled - camera, rotation)
    image = local[:, :2] / local[:, 2:]
    low, high = image.min(axis=0), image.max(axis=0)
    pixels_per_unit = _FILL * side / max(float((high - low).max()), 1e-12)
    image = (image - (low + high) / 2) * pixels_per_unit + side / 2

    faces, away = _drawn(image, mesh.faces)
    inverse_depth = 1 / local[:, 2]  # linear in the image
    owner, weights, _ = rasterize_triangles(image[faces], side, side, depths=-inverse_depth[faces])
    covered = np.flatnonzero(owner >= 0)
    corners = faces[owner.reshape(-1)[covered]]
    share = weights.reshape(-1, 3)[covered] * inverse_depth[corners]
    share = (share / share.sum(axis=1, keepdims=True))[..., None]  # correct in perspective
    normals = _unit((mesh.normals[corners] * share).sum(axis=1))
    views = _unit(camera - (scaled[corners] * share).sum(axis=1))
    uvs = (mesh.uvs[corners].astype(np.float64) * share).sum(axis=1) % 1.0
    return ObjectView(covered, corners, -normals if away else normals, views, np.minimum(uvs, 1 - 1e-9))


def _drawn(image: Array, faces: NDArray[np.int32]) -> tuple[NDArray[np.int32], bool]:
    """The triangles that face the camera, or all triangles and True where none does."""
    a, b, c = image[faces].transpose(1, 0, 2)
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    facing = area < 0  # rows increase downwards
    return (faces[facing], False) if facing.any() else (faces, True)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12))
