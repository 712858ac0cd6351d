"""Closest hits and occlusion by Mitsuba's ray tracer (Embree on the CPU, OptiX on CUDA), arrays in, arrays out."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from hir_plugins.reflectance_renderers.drjit_types import DrJitArray, MitsubaObject
from hir_plugins.reflectance_renderers.mitsuba_variant import mitsuba_on
from hir_plugins.reflectance_renderers.ray_acceleration import mesh_scene

RAYS_PER_LAUNCH = 1 << 21
"""Bounds the memory of a launch at about 100 MB."""


@dataclass(frozen=True)
class Hits:
    """First hits of N rays; `face` is −1 for a miss."""

    face: NDArray[np.int32]
    barycentric: NDArray[np.float32]
    """(N, 2): weights of the face's second and third corner."""


class RayTracer:
    """One acceleration structure over one mesh."""

    def __init__(self, positions: NDArray[np.float32], faces: NDArray[np.int32], device: str = "cpu") -> None:
        mi = mitsuba_on(device)
        flat_positions = mi.Float(np.ascontiguousarray(positions, dtype=np.float32).ravel())
        flat_faces = mi.UInt32(np.ascontiguousarray(faces, dtype=np.uint32).ravel())
        self.scene = mesh_scene(mi, flat_positions, flat_faces, len(positions), len(faces))
        """For kernels that trace rays of their own."""
        self._mi = mi

    def closest(self, origins: NDArray[np.float32], directions: NDArray[np.float32]) -> Hits:
        """First hit of each ray (N, 3), (N, 3)."""
        face, barycentric = [], []
        for start in range(0, len(origins), RAYS_PER_LAUNCH):
            ray = self._ray(origins[start : start + RAYS_PER_LAUNCH], directions[start : start + RAYS_PER_LAUNCH])
            # not `coherent`: Embree traces rays in all directions four times faster without it, and camera rays as fast
            hit = self.scene.ray_intersect_preliminary(ray, coherent=False)
            is_valid, u, v = hit.is_valid(), hit.prim_uv.x, hit.prim_uv.y
            # one kernel for all results: each array that is read alone would trace the rays again
            dr.eval(is_valid, hit.prim_index, u, v)
            valid = np.asarray(is_valid).astype(bool)
            face.append(np.where(valid, np.asarray(hit.prim_index).astype(np.int32), -1))
            uv = np.stack([np.asarray(u), np.asarray(v)], axis=1)
            barycentric.append(np.where(valid[:, None], uv, 0).astype(np.float32))
        if not face:
            return Hits(np.empty(0, np.int32), np.empty((0, 2), np.float32))
        return Hits(np.concatenate(face), np.concatenate(barycentric))

    def occluded(self, origins: NDArray[np.float32], directions: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Whether each ray (N, 3), (N, 3) hits the mesh."""
        chunks = [
            np.asarray(
                self.scene.ray_test(self._ray(origins[s : s + RAYS_PER_LAUNCH], directions[s : s + RAYS_PER_LAUNCH]))
            ).astype(bool)
            for s in range(0, len(origins), RAYS_PER_LAUNCH)
        ]
        return np.concatenate(chunks) if chunks else np.empty(0, bool)

    def _ray(self, origins: NDArray[np.float32], directions: NDArray[np.float32]) -> MitsubaObject:
        mi = self._mi
        return mi.Ray3f(mi.Point3f(*_columns(origins, mi)), mi.Vector3f(*_columns(directions, mi)))


def _columns(array: NDArray[np.float32], mi: ModuleType) -> list[DrJitArray]:
    return [mi.Float(np.ascontiguousarray(array[:, i], dtype=np.float32)) for i in range(3)]
