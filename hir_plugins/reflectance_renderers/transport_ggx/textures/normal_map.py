"""Conversion between normal offsets in the world and normal maps, in MikkTSpace frames as in every engine."""

from __future__ import annotations

import numpy as np
import torch
from hir_exporters.mesh.tangents import corner_tangents
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from hir_core.mesh.texel_rasterization import dilate, interpolate, texel_surface
from hir_core.scene import Mesh
from hir_plugins.reflectance_renderers.transport_ggx.operator.shading_normals import offset_normals
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import Surface, SurfacePoints

MIN_FRAME_VOLUME = 1e-3
"""Least volume (determinant) of a tangent frame; a flatter one gives the normal (0, 0, 1)."""


def normal_map(mesh: Mesh, normal_offset: Float[Tensor, "H W 3"], padding: int) -> Float[Tensor, "H W 3"]:
    """Unit vectors in the mesh's tangent frames, of normal offsets in the world; (0, 0, 1) beyond `padding` texels."""
    assert mesh.uvs is not None and mesh.topology.uv_faces is not None
    surface = texel_surface(mesh, (normal_offset.shape[0], normal_offset.shape[1]))
    frames = _tangents(mesh.positions, mesh.normals, mesh.faces, mesh.uvs[mesh.topology.uv_faces])[surface.face]
    normal = normalize(interpolate(mesh.normals, mesh.faces, surface.face, surface.barycentric), dim=1, eps=1e-12)
    axes = _axes(normal, frames, surface.barycentric)
    flat = torch.tensor([0.0, 0.0, 1.0], device=normal_offset.device)
    sound = torch.linalg.det(axes).abs() > MIN_FRAME_VOLUME
    axes = torch.where(sound[:, None, None], axes, torch.eye(3, device=normal_offset.device))
    tangent_space = torch.linalg.solve(axes, offset_normals(normal, normal_offset[surface.covered]))
    texture = flat.expand(*normal_offset.shape[:2], 3).clone()
    texture[surface.covered] = torch.where(sound[:, None], normalize(tangent_space, dim=1, eps=1e-12), flat)
    return normalize(dilate(texture, surface.covered, padding), dim=2, eps=1e-12)


def mapped_normals(surface: Surface, points: SurfacePoints, values: Float[Tensor, "P 3"]) -> Float[Tensor, "P 3"]:
    """Unit normals in the world, of values of a normal map; the frames are those of the refined surface."""
    assert surface.corner_uvs is not None
    frames = _tangents(surface.positions, surface.normals, surface.faces, surface.corner_uvs)[points.face]
    axes = _axes(points.normal, frames, points.barycentric)
    return normalize((axes @ values[..., None])[..., 0], dim=1, eps=1e-12)


def _axes(
    normal: Float[Tensor, "P 3"], frames: Float[Tensor, "P 3 4"], barycentric: Float[Tensor, "P 3"]
) -> Float[Tensor, "P 3 3"]:
    """Columns: tangent, bitangent, normal, interpolated as engines do."""
    tangent = (frames[..., :3] * barycentric[..., None]).sum(dim=1)
    bitangent = frames[:, 0, 3:] * torch.linalg.cross(normal, tangent)
    return torch.stack([tangent, bitangent, normal], dim=2)


def _tangents(
    positions: Float[Tensor, "V 3"], normals: Float[Tensor, "V 3"], faces: Tensor, uvs: Float[Tensor, "F 3 2"]
) -> Float[Tensor, "F 3 4"]:
    corners = faces.reshape(-1)
    position, normal, uv = (
        a.detach().cpu().numpy() for a in (positions[corners], normals[corners], uvs.reshape(-1, 2))
    )
    tangents = corner_tangents(position, normal, uv, np.arange(len(corners), dtype=np.int32).reshape(-1, 3))
    return torch.from_numpy(tangents).to(positions).reshape(-1, 3, 4)
