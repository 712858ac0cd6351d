"""The atlas stage: unwraps the mesh at the resolution of the photographs and bakes its vertex colours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray

from hir_core.capture import Camera, Capture
from hir_core.config import AtlasSettings
from hir_core.errors import ConfigError, StageError
from hir_core.mesh.texel_rasterization import TexelSurface, dilate, texel_surface, texture_of_vertices
from hir_core.mesh.uv_charts import cut_and_pack
from hir_core.scene import Material, Mesh, Scene, Topology
from hir_core.scene.scan import UV_TOLERANCE

if TYPE_CHECKING:
    from hir_core.run.stage_context import StageContext

SIDE_MIN, SIDE_MAX = 64, 4096
"""Sides in texels of a derived texture."""
_PACKING_SIDE_MAX = 1024
"""Charts are packed on at most this many texels: finer packing takes minutes and gains nothing."""
_FILL = 0.6
"""Share of an atlas that charts fill, measured on spot, bumpy spheres and marching-cubes meshes (0.58 to 0.79)."""
_ROUNDING_LOG2 = 0.07
"""A power of two that is 5 % too small is accepted: twice the side takes four times the memory."""
_TEXELS_PER_PIXEL_MIN = 0.5
"""Covered texels for each pixel of the closest view, below which a derived texture gets twice the side. Many small
charts leave most of an atlas empty: those of long thin triangles 0.33, where textures showed stripes."""
_OVERLAP_MAX = 0.002
"""Share of texels that may be claimed twice by texture coordinates that a mesh already has."""
_OVERLAP_TEST_SIDE = 512
_OVERLAP = "has texture coordinates that overlap (as mirrored halves and several materials have)"
_SETTING_MAX = 16384


@dataclass(frozen=True)
class AtlasReport:
    """What the stage reports; the fields are the keys of its report in run.json."""

    texture_size: int
    """Side of the textures in texels."""
    used: float
    """Share of the texels that charts cover."""
    charts: int | None
    """Of a new atlas; None where the mesh's own texture coordinates were kept."""


def unwrap(
    scene: Scene, capture: Capture, settings: AtlasSettings, context: StageContext, mesh_name: str = "the mesh"
) -> tuple[Scene, AtlasReport]:
    """The scene with texture coordinates and a diffuse texture of its vertex colours.

    Texture coordinates that the mesh already has are kept where they lie in 0…1 and do not overlap; those that leave it
    by `UV_TOLERANCE` or less are moved to the border. `mesh_name` is what messages call the mesh.
    """
    # none where the size is set: it then stays, however little of it the charts cover
    pixels = 0.0 if settings.texture_size else _pixels_of_closest_views(scene.mesh, capture.cameras)
    size = settings.texture_size or _texture_size(pixels)
    if size < 1 or size > _SETTING_MAX:
        raise ConfigError(f"atlas.texture_size is {size}; it must lie between 1 and {_SETTING_MAX} (0 derives it)")
    mesh, charts = _with_rounded_border(scene.mesh), None
    problem = _problem_of_coordinates(mesh)
    if problem:
        if settings.texture_coordinates == "keep":
            raise StageError(
                f"{mesh_name} {problem}, so they cannot be kept; unwrap it without overlaps on one square in the "
                "program that made it, or make new ones: --set 'atlas.texture_coordinates=\"auto\"'"
            )
        if mesh.uvs is not None:
            context.warn(f"{mesh_name} {problem}; new ones replace them")
        mesh, charts = unwrap_mesh(mesh, size, settings.padding)
    surface = texel_surface(mesh, size)
    while size < SIDE_MAX and len(surface.face) < _TEXELS_PER_PIXEL_MIN * pixels:
        size *= 2
        if charts is not None:
            mesh, charts = unwrap_mesh(mesh, size, settings.padding)
        surface = texel_surface(mesh, size)
    used = round(float(surface.covered.float().mean()), 4)
    material = scene.material or _baked_colors(mesh, surface, settings.padding)
    return replace(scene, mesh=mesh, material=material), AtlasReport(size, used, charts)


def unwrap_mesh(mesh: Mesh, size: int, padding: int = 4) -> tuple[Mesh, int]:
    """The mesh cut into charts that are packed (xatlas) at least `padding` texels of a `size`² texture apart, and how
    many charts.

    Every face gets coordinates; those of a face without area are one point. Origin top-left, in 0…1.
    """
    packed = min(size, _PACKING_SIDE_MAX)
    positions = np.ascontiguousarray(mesh.positions.detach().cpu().numpy(), dtype=np.float32)
    faces = mesh.faces.cpu().numpy()
    if not len(faces):
        raise StageError("the mesh has no triangles to unwrap; check the geometry stage")
    # xatlas may return a box that is a quarter wider than requested, which is then scaled down
    gap = max(1, math.ceil(1.25 * padding * packed / size)) if padding else 0
    uv_faces, uvs, charts = cut_and_pack(positions, faces, packed, gap)
    device = mesh.positions.device
    topology = Topology(mesh.faces, torch.from_numpy(uv_faces).to(device))
    coordinates = torch.from_numpy(uvs.astype(np.float32)).to(device)
    return replace(mesh, topology=topology, uvs=coordinates), charts


def texture_size(mesh: Mesh, cameras: Sequence[Camera]) -> int:
    """Side of a square texture, a power of two, with about one texel for each pixel of the closest view.

    With fewer texels textures blur: captures/spot needs 641, and with 1024 its unseen views have 0.35 dB more (object)
    than with 512.
    """
    return _texture_size(_pixels_of_closest_views(mesh, cameras))


def _texture_size(pixels: float) -> int:
    power = math.ceil(math.log2(max(math.sqrt(pixels / _FILL), 1.0)) - _ROUNDING_LOG2)
    return int(min(max(2**power, SIDE_MIN), SIDE_MAX))


def _pixels_of_closest_views(mesh: Mesh, cameras: Sequence[Camera]) -> float:
    """Sum over faces of the largest number of pixels that a face fills in the image of a camera that it faces;
    occlusion is ignored.
    """
    positions = mesh.positions.detach().cpu().numpy().astype(np.float64)
    faces = mesh.faces.cpu().numpy()
    pixels = np.zeros(len(faces))
    for camera in cameras:
        pixels = np.maximum(pixels, _face_pixels(positions, faces, camera))
    return float(pixels.sum())


def _face_pixels(positions: NDArray[np.float64], faces: NDArray[np.int64], camera: Camera) -> NDArray[np.float64]:
    """Area in pixels of each face that faces the camera inside its image, else 0."""
    pixels, depth = camera.project(positions)
    a, b, c = pixels[faces[:, 0]], pixels[faces[:, 1]], pixels[faces[:, 2]]
    # y points down, so counter-clockwise seen from outside is a negative area here
    area = -0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    middle = (a + b + c) / 3
    inside = (middle > 0).all(axis=1) & (middle < [camera.width, camera.height]).all(axis=1)
    return np.where(inside & (depth[faces] > 0).all(axis=1), np.maximum(area, 0), 0)


def _with_rounded_border(mesh: Mesh) -> Mesh:
    """The mesh with coordinates in 0…1 where they leave it by no more than rounding; else the same mesh."""
    if mesh.uvs is None or not mesh.uvs.numel():
        return mesh
    beyond = max(-float(mesh.uvs.min()), float(mesh.uvs.max()) - 1)  # NaN is not greater
    return replace(mesh, uvs=mesh.uvs.clamp(0, 1)) if 0 < beyond <= UV_TOLERANCE else mesh


def _problem_of_coordinates(mesh: Mesh) -> str:
    """Why the mesh's own texture coordinates cannot be used; empty where they lie in 0…1 and cover no texel twice."""
    if mesh.uvs is None or mesh.topology.uv_faces is None or not bool(torch.isfinite(mesh.uvs).all()):
        return "has no texture coordinates"
    if float(mesh.uvs.min()) < 0 or float(mesh.uvs.max()) > 1:
        return "has texture coordinates outside 0…1 (as UDIM tiles and repeated textures have)"
    a, b, c = mesh.uvs[mesh.topology.uv_faces].double().unbind(1)
    doubled_area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    if float(doubled_area.abs().sum()) / 2 > 1:
        return _OVERLAP
    surface = texel_surface(mesh, _OVERLAP_TEST_SIDE)
    if not len(surface.face):
        return "has texture coordinates without an area"
    return _OVERLAP if surface.overlaps > _OVERLAP_MAX * len(surface.face) else ""


def _baked_colors(mesh: Mesh, surface: TexelSurface, padding: int) -> Material:
    """A Lambert material with a texture of the vertex colours; mid-grey for a mesh without them.

    That is a texture, too: later stages fit as many texels as this one has.
    """
    like = mesh.positions
    black, fully_rough = like.new_zeros(3), like.new_ones(1)
    if mesh.vertex_colors is None:
        return Material("paper", like.new_full((*surface.covered.shape, 3), 0.5), black, fully_rough)
    texture = texture_of_vertices(mesh, mesh.vertex_colors.clamp(0, 1), surface)
    return Material("paper", dilate(texture, surface.covered, 2 * padding), black, fully_rough)
