"""Mitsuba's acceleration structure over one mesh: Embree on the CPU, OptiX on CUDA.

The only builder of such scenes. `ray_tracer` traces rays from and to numpy arrays on either device;
`mitsuba_ggx.mitsuba_mesh` and `transport_ggx.operator.lobes` trace them inside Dr.Jit kernels. Code without Mitsuba
uses open3d: `hir_core.mesh.ray_casting`.
"""

from __future__ import annotations

from types import ModuleType

from hir_plugins.reflectance_renderers.drjit_types import DrJitArray, MitsubaObject


def mesh_scene(
    mi: ModuleType, positions: DrJitArray, faces: DrJitArray, vertex_count: int, face_count: int
) -> MitsubaObject:
    """The scene of one mesh: flat `mi.Float` positions (3 · vertex_count) and `mi.UInt32` faces (3 · face_count)."""
    mesh = mi.Mesh("surface", vertex_count=vertex_count, face_count=face_count)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = positions
    parameters["faces"] = faces
    parameters.update()
    return mi.load_dict({"type": "scene", "surface": mesh})
