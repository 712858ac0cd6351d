"""The frozen mesh: ray intersections and shading normals."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
import torch
from hir_exporters.mesh.tangents import corner_tangents
from torch import Tensor

from hir_core.errors import StageError
from hir_core.scene import Mesh
from hir_plugins.reflectance_renderers.drjit_arrays import floats, to_float, to_uint
from hir_plugins.reflectance_renderers.drjit_types import DrJitArray
from hir_plugins.reflectance_renderers.ray_acceleration import mesh_scene

_RAY_OFFSET = 2e-5
"""Distance of ray origins from the surface, in radii of the object: a few float32 steps."""


@dataclass
class FirstHit:
    """What a ray hits first."""

    is_hit: DrJitArray
    """The ray hit the mesh."""
    face: DrJitArray
    u: DrJitArray
    """Weight of the face's second corner."""
    v: DrJitArray
    """Weight of its third corner."""


@dataclass(frozen=True)
class SurfaceHit:
    """Intersections of rays with the surface; only meaningful where `valid`."""

    valid: DrJitArray
    """The ray hit the front of a face."""
    is_hit: DrJitArray
    """The ray hit the mesh."""
    position: DrJitArray
    geometric: DrJitArray
    """Normal of the face."""
    normal: DrJitArray
    """Interpolated vertex normal, or that of the normal map."""
    u: DrJitArray
    v: DrJitArray
    face: DrJitArray
    weights: tuple[DrJitArray, DrJitArray, DrJitArray]


class Surface:
    """A mesh, scaled to the unit sphere, with its acceleration structure."""

    def __init__(self, mesh: Mesh) -> None:
        positions = mesh.positions.detach()
        used = positions[mesh.faces.reshape(-1)]
        if not len(used) or not bool(torch.isfinite(used).all()):
            raise StageError("the mesh to render is empty or has vertices that are not finite")
        low, high = used.amin(0).double(), used.amax(0).double()
        self.center = ((low + high) / 2).cpu().numpy()
        self.radius = max(float((used.double() - (low + high) / 2).norm(dim=1).max()), 1e-30)
        middle = torch.from_numpy(self.center).to(positions.device)
        unit = ((positions.double() - middle) / self.radius).float()
        self.device = positions.device
        self._mesh = mesh
        # padded, so that they are gathered as packets of four
        self._positions = to_float(_four(unit), mi)
        self._normals = to_float(_four(mesh.normals), mi)
        self._faces = to_uint(_four(mesh.faces), mi)
        self._uvs = self._uv_faces = self._tangents = None
        if mesh.uvs is not None and mesh.topology.uv_faces is not None:
            self._uvs = to_float(mesh.uvs, mi)
            self._uv_faces = to_uint(_four(mesh.topology.uv_faces), mi)
        self.scene = mesh_scene(mi, to_float(unit, mi), to_uint(mesh.faces, mi), len(unit), len(mesh.faces))

    @property
    def has_uvs(self) -> bool:
        """Whether the mesh has texture coordinates."""
        return self._uvs is not None

    def intersect(
        self, origin: DrJitArray, direction: DrJitArray, active: DrJitArray, coherent: bool = False
    ) -> SurfaceHit:
        """First hits of rays in the unit sphere."""
        return self.at(self.first_hit(origin, direction, active, coherent), direction)

    def first_hit(
        self, origin: DrJitArray, direction: DrJitArray, active: DrJitArray, coherent: bool = False
    ) -> FirstHit:
        """First hits of rays in the unit sphere: faces, and positions in them."""
        hit = self.scene.ray_intersect_preliminary(mi.Ray3f(origin, direction), coherent=coherent, active=active)
        return FirstHit(hit.is_valid() & active, hit.prim_index, hit.prim_uv.x, hit.prim_uv.y)

    def at(self, hit: FirstHit, direction: DrJitArray) -> SurfaceHit:
        """The surface where rays along `direction` hit it."""
        is_hit = hit.is_hit
        corners = self._corners(self._faces, hit.face, is_hit)
        b, c = hit.u, hit.v
        weights = (1 - b - c, b, c)
        p = [_vector(self._positions, i, is_hit) for i in corners]
        n = [_vector(self._normals, i, is_hit) for i in corners]
        position = _mix(p, weights)
        geometric = dr.cross(p[1] - p[0], p[2] - p[0])
        geometric *= dr.rcp(dr.maximum(dr.norm(geometric), 1e-30))
        normal = _mix(n, weights)
        length = dr.norm(normal)
        normal = dr.select(length > 1e-6, normal / dr.maximum(length, 1e-6), geometric)
        u = v = mi.Float(0)
        if self._uvs is not None:
            uv = [dr.gather(mi.Vector2f, self._uvs, i, is_hit) for i in self._corners(self._uv_faces, hit.face, is_hit)]
            mixed = _mix(uv, weights)
            u, v = mixed.x, mixed.y
        valid = is_hit & (dr.dot(geometric, direction) < 0)
        return SurfaceHit(valid, is_hit, position, geometric, normal, u, v, hit.face, weights)

    def occluded(
        self, origin: DrJitArray, direction: DrJitArray, active: DrJitArray, distance: DrJitArray | None = None
    ) -> DrJitArray:
        """Whether rays hit the mesh, before a `distance` if there is one."""
        ray = mi.Ray3f(origin, direction)
        if distance is not None:
            ray.maxt = distance
        return self.scene.ray_test(ray, active=active)

    def start(self, point: SurfaceHit, direction: DrJitArray) -> DrJitArray:
        """Origin of a ray from the surface in a direction."""
        side = dr.select(dr.dot(point.geometric, direction) >= 0, _RAY_OFFSET, -_RAY_OFFSET)
        return point.position + point.geometric * side

    def mapped_normal(self, point: SurfaceHit, tangent_normal: DrJitArray) -> DrJitArray:
        """Normal in the world of a vector of a normal map, in MikkTSpace frames."""
        if self._tangents is None:
            self._tangents = self._upload_tangents()
        corner = [dr.gather(mi.Vector4f, self._tangents, point.face * 3 + i, point.valid) for i in range(3)]
        tangent = _mix([mi.Vector3f(t.x, t.y, t.z) for t in corner], point.weights)
        bitangent = corner[0].w * dr.cross(point.normal, tangent)
        normal = tangent_normal.x * tangent + tangent_normal.y * bitangent + tangent_normal.z * point.normal
        length = dr.norm(normal)
        return dr.select(length > 1e-6, normal / dr.maximum(length, 1e-6), point.normal)

    def _upload_tangents(self) -> DrJitArray:
        mesh = self._mesh
        if mesh.uvs is None or mesh.topology.uv_faces is None:
            raise StageError("a normal map needs texture coordinates; let the atlas stage run")
        faces, uv_faces = mesh.faces.cpu().numpy().reshape(-1), mesh.topology.uv_faces.cpu().numpy().reshape(-1)
        corners = np.arange(len(faces), dtype=np.int32).reshape(-1, 3)
        positions, normals = mesh.positions.detach().cpu().numpy(), mesh.normals.detach().cpu().numpy()
        tangents = corner_tangents(positions[faces], normals[faces], mesh.uvs.detach().cpu().numpy()[uv_faces], corners)
        return floats(tangents, mi)

    def _corners(
        self, faces: DrJitArray, index: DrJitArray, active: DrJitArray
    ) -> tuple[DrJitArray, DrJitArray, DrJitArray]:
        corners = dr.gather(mi.Vector4u, faces, index, active)
        return corners.x, corners.y, corners.z


def _vector(values: DrJitArray, index: DrJitArray, active: DrJitArray) -> DrJitArray:
    packet = dr.gather(mi.Vector4f, values, index, active)
    return mi.Vector3f(packet.x, packet.y, packet.z)


def _mix(values: list[DrJitArray], weights: tuple[DrJitArray, DrJitArray, DrJitArray]) -> DrJitArray:
    return values[0] * weights[0] + values[1] * weights[1] + values[2] * weights[2]


def _four(rows: Tensor) -> Tensor:
    return torch.nn.functional.pad(rows, (0, 1))
