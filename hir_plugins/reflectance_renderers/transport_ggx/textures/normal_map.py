"""Between bent normals in the world and normal maps, whose frames are MikkTSpace's as in every engine."""

from __future__ import annotations

import numpy as np
import torch
from hir_exporters.mesh.tangents import corner_tangents
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from hir_core.mesh.texel_rasterization import dilate, interpolate
from hir_core.scene import Mesh
from hir_core.stages.atlas import texel_surface
from hir_plugins.reflectance_renderers.transport_ggx.fit.shading_normals import bent
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import Surface, SurfacePoints

FLATTEST = 1e-3
"""Volume that a frame must span for vectors to be read in it."""


def normal_map(mesh: Mesh, tilt: Float[Tensor, "H W 3"], padding: int) -> Float[Tensor, "H W 3"]:
    """Unit vectors in the mesh's tangent frames of tilts in the world; (0, 0, 1) farther than `padding` from charts."""
    assert mesh.uvs is not None and mesh.topology.uv_faces is not None
    surface = texel_surface(mesh, (tilt.shape[0], tilt.shape[1]))
    frames = _tangents(mesh.positions, mesh.normals, mesh.faces, mesh.uvs[mesh.topology.uv_faces])[surface.face]
    normal = normalize(interpolate(mesh.normals, mesh.faces, surface.face, surface.barycentric), dim=1, eps=1e-12)
    axes = _axes(normal, frames, surface.barycentric)
    flat = torch.tensor([0.0, 0.0, 1.0], device=tilt.device)
    sound = torch.linalg.det(axes).abs() > FLATTEST
    axes = torch.where(sound[:, None, None], axes, torch.eye(3, device=tilt.device))
    turned = torch.linalg.solve(axes, bent(normal, tilt[surface.covered]))
    found = flat.expand(*tilt.shape[:2], 3).clone()
    found[surface.covered] = torch.where(sound[:, None], normalize(turned, dim=1, eps=1e-12), flat)
    return normalize(dilate(found, surface.covered, padding), dim=2, eps=1e-12)


def mapped_normals(surface: Surface, points: SurfacePoints, values: Float[Tensor, "P 3"]) -> Float[Tensor, "P 3"]:
    """Unit normals in the world of what a normal map holds at points; the frames are those of the refined surface."""
    assert surface.corner_uvs is not None
    frames = _tangents(surface.positions, surface.normals, surface.faces, surface.corner_uvs)[points.face]
    axes = _axes(points.normal, frames, points.barycentric)
    return normalize((axes @ values[..., None])[..., 0], dim=1, eps=1e-12)


def _axes(
    normal: Float[Tensor, "P 3"], frames: Float[Tensor, "P 3 4"], barycentric: Float[Tensor, "P 3"]
) -> Float[Tensor, "P 3 3"]:
    """Columns: tangent, bitangent, normal, mixed as engines mix them."""
    tangent = (frames[..., :3] * barycentric[..., None]).sum(dim=1)
    bitangent = frames[:, 0, 3:] * torch.linalg.cross(normal, tangent)
    return torch.stack([tangent, bitangent, normal], dim=2)


def _tangents(
    positions: Float[Tensor, "V 3"], normals: Float[Tensor, "V 3"], faces: Tensor, uvs: Float[Tensor, "F 3 2"]
) -> Float[Tensor, "F 3 4"]:
    corners = faces.reshape(-1)
    place, normal, uv = (a.detach().cpu().numpy() for a in (positions[corners], normals[corners], uvs.reshape(-1, 2)))
    found = corner_tangents(place, normal, uv, np.arange(len(corners), dtype=np.int32).reshape(-1, 3))
    return torch.from_numpy(found).to(positions).reshape(-1, 3, 4)
