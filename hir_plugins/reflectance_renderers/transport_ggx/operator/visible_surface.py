"""The frozen surface, and the surface points behind the pixels of a capture: normals, directions to the camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import normalize

from hir_core.capture import Camera
from hir_core.scene import Mesh, Topology
from hir_plugins.reflectance_renderers.ray_tracer import RayTracer

MAX_REFINED_FACES = 400_000
"""Coarse meshes are not subdivided beyond this number of faces."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles with the vertex normals of the mesh they subdivide and the texture coordinates of their corners."""

    positions: Float[Tensor, "V 3"]
    normals: Float[Tensor, "V 3"]
    faces: Int[Tensor, "F 3"]
    corner_uvs: Float[Tensor, "F 3 2"] | None

    @property
    def face_normals(self) -> Float[Tensor, "F 3"]:
        """Unit normals of the faces; zero where a face has no area."""
        a, b, c = self.positions[self.faces].unbind(1)
        return normalize(torch.linalg.cross(b - a, c - a), dim=1, eps=1e-30)


def refined_mesh(surface: Surface) -> Mesh:
    """The surface as a mesh with texture coordinates for each corner."""
    assert surface.corner_uvs is not None
    corners = torch.arange(3 * len(surface.faces), device=surface.faces.device).reshape(-1, 3)
    return Mesh(surface.positions, Topology(surface.faces, corners), surface.corner_uvs.reshape(-1, 2))


def refine(mesh: Mesh, vertices: int) -> Surface:
    """The surface of a mesh, subdivided until it has about `vertices` vertices; its shape does not change."""
    uvs = None
    if mesh.uvs is not None and mesh.topology.uv_faces is not None:
        uvs = mesh.uvs[mesh.topology.uv_faces]
    surface = Surface(mesh.positions, mesh.normals, mesh.faces, uvs)
    while len(surface.positions) * 2 < vertices and 4 * len(surface.faces) <= MAX_REFINED_FACES:
        surface = _split(surface)
    return surface


def _split(surface: Surface) -> Surface:
    """Splits every triangle into four; normals are interpolated, so shading does not change."""
    corner = torch.stack([surface.faces[:, [0, 1]], surface.faces[:, [1, 2]], surface.faces[:, [2, 0]]], dim=1)
    flat = corner.reshape(-1, 2).sort(dim=1).values
    unique, inverse = torch.unique(flat, dim=0, return_inverse=True)
    middle = inverse.reshape(-1, 3) + len(surface.positions)
    positions = torch.cat([surface.positions, surface.positions[unique].mean(dim=1)])
    normals = torch.cat([surface.normals, normalize(surface.normals[unique].sum(dim=1), dim=1, eps=1e-12)])
    a, b, c = surface.faces.unbind(1)
    ab, bc, ca = middle.unbind(1)
    quads = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    faces = torch.stack([torch.stack(q, dim=1) for q in quads], dim=1).reshape(-1, 3)
    uvs = surface.corner_uvs
    if uvs is not None:
        u, v, w = uvs.unbind(1)
        uv, vw, wu = (u + v) / 2, (v + w) / 2, (w + u) / 2
        parts = [(u, uv, wu), (uv, v, vw), (wu, vw, w), (uv, vw, wu)]
        uvs = torch.stack([torch.stack(p, dim=1) for p in parts], dim=1).reshape(-1, 3, 2)
    return Surface(positions, normals, faces, uvs)


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Surface points, each with the view that sees it."""

    view: Int[Tensor, " P"]
    face: Int[Tensor, " P"]
    barycentric: Float[Tensor, "P 3"]
    position: Float[Tensor, "P 3"]
    normal: Float[Tensor, "P 3"]
    """Unit shading normal, interpolated from the vertices."""
    face_normal: Float[Tensor, "P 3"]
    to_eye: Float[Tensor, "P 3"]

    def __len__(self) -> int:
        return len(self.face)

    @property
    def view_cosine(self) -> Float[Tensor, " P"]:
        """Cosine between the shading normal and the direction to the camera."""
        return (self.normal * self.to_eye).sum(dim=1)

    def take(self, rows: Tensor | slice) -> SurfacePoints:
        """The points of `rows`; of a slice without a copy."""
        return SurfacePoints(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    def with_normals(self, normal: Float[Tensor, "P 3"]) -> SurfacePoints:
        """The same points with other shading normals."""
        return replace(self, normal=normal)

    def uvs(self, surface: Surface) -> Float[Tensor, "P 2"]:
        """Texture coordinates of the points."""
        if surface.corner_uvs is None:
            raise ValueError("the mesh has no texture coordinates; unwrap it first (hir_core.stages.atlas.unwrap)")
        return (surface.corner_uvs[self.face] * self.barycentric[..., None]).sum(1)


def visible_points(
    tracer: RayTracer, surface: Surface, cameras: Mapping[int, Camera], pixels: Int[Tensor, "N 3"], offset: float = 0.5
) -> tuple[SurfacePoints, Bool[Tensor, " N"]]:
    """Surface points behind pixels (view, x, y), and which pixels see the front of the surface.

    Pixels without a hit have the data of the first face. `offset` is the position of the ray in the pixel (0.5:
    centre).
    """
    index = pixels.cpu().numpy()
    origins = np.empty((len(index), 3), np.float32)
    directions = np.empty((len(index), 3), np.float32)
    for view in np.unique(index[:, 0]):
        rows = index[:, 0] == view
        # float64 up to here: coordinates far from the origin keep their precision
        origin, direction = cameras[int(view)].rays(index[rows, 1:].astype(np.float64) + offset)
        origins[rows], directions[rows] = origin, direction
    hits = tracer.closest(origins, directions)
    device = surface.positions.device
    face = torch.from_numpy(hits.face.astype(np.int64)).to(device)
    uv = torch.from_numpy(hits.barycentric).to(device)
    points = locate(surface, face.clamp_min(0), uv, -torch.from_numpy(directions).to(device), pixels[:, 0].to(device))
    front = (points.face_normal * points.to_eye).sum(1) > 0
    return points, (face >= 0) & front


def locate(surface: Surface, face: Tensor, uv: Tensor, to_eye: Tensor, view: Tensor) -> SurfacePoints:
    """Points at barycentric (u, v) of faces, with interpolated normals."""
    barycentric = torch.stack([1 - uv[:, 0] - uv[:, 1], uv[:, 0], uv[:, 1]], dim=1)
    corners = surface.faces[face]
    position = (surface.positions[corners] * barycentric[..., None]).sum(1)
    normal = normalize((surface.normals[corners] * barycentric[..., None]).sum(1), dim=1, eps=1e-12)
    return SurfacePoints(view.long(), face, barycentric, position, normal, surface.face_normals[face], to_eye)


def tangent_frame(normal: Float[Tensor, "N 3"]) -> tuple[Float[Tensor, "N 3"], Float[Tensor, "N 3"]]:
    """Tangent and bitangent of unit normals, without a singularity (Duff et al. 2017)."""
    x, y, z = normal.unbind(1)
    sign = torch.where(z >= 0, 1.0, -1.0)
    a = -1 / (sign + z)
    b = x * y * a
    tangent = torch.stack([1 + sign * x * x * a, sign * b, -sign * x], dim=1)
    bitangent = torch.stack([b, sign + y * y * a, -y], dim=1)
    return tangent, bitangent
