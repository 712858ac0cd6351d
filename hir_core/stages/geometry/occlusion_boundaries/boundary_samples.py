"""Points on the occlusion boundaries of a mesh: visible edges behind which a farther part of the object appears.

An edge bounds what a view sees of a closed mesh where one of its two faces is turned towards the camera and the other
away. Its points are samples of a boundary integral, as in Li, Aittala, Durand, Lehtinen 2018, *Differentiable Monte
Carlo Ray Tracing through Edge Sampling*: when a boundary moves outwards by dx, the nearer surface replaces the farther
one on a strip of that width.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy.typing import NDArray
from torch import Tensor

from hir_core.mesh.ray_casting import MeshQueries
from hir_core.scene import Mesh, Topology
from hir_core.stages.geometry.depth_jumps import LEAST_JUMP_PIXELS
from hir_core.stages.geometry.occlusion_boundaries.view_photographs import ViewPhotographs

BESIDE_PIXELS = 0.25
"""How far from the edge the two surfaces are looked up. Vertices move by less between two ray structures."""

SAMPLE_SPACING_PIXELS = 2.0
"""An edge is sampled about so often."""

SAMPLES_PER_EDGE_MAX = 64
"""Of one edge."""


@dataclass(frozen=True, eq=False)
class EdgeFaces:
    """The edges of a mesh, with two faces each."""

    ends: Int[Tensor, "E 2"]
    faces: Int[Tensor, "E 2"]
    """The number of faces F where there is no second one; of more than two the first two."""

    @classmethod
    def of(cls, topology: Topology) -> EdgeFaces:
        """Builds the table, once for each topology."""
        edge, face = topology.edge_faces
        order = torch.argsort(edge, stable=True)
        edge, face = edge[order], face[order]
        rank = torch.arange(len(edge), device=edge.device) - torch.searchsorted(edge, edge)
        faces = torch.full((len(topology.edges), 2), len(topology.faces), dtype=torch.int64, device=edge.device)
        for slot in (0, 1):
            faces[edge[rank == slot], slot] = face[rank == slot]
        return cls(topology.edges.long(), faces)


@dataclass(frozen=True, eq=False)
class BoundarySamples:
    """Points on occlusion boundaries of some views."""

    views: Sequence[int]
    row: Int[Tensor, " S"]
    """Index into `views`."""
    ends: Int[Tensor, "S 2"]
    """The vertices of the edge."""
    fraction: Float[Tensor, " S"]
    """Position along it, 0…1."""
    length: Float[Tensor, " S"]
    """Length in pixels of the piece of the edge that the sample stands for."""
    pixels: Float[Tensor, "S 2"]
    outward: Float[Tensor, "S 2"]
    """Unit normal of the boundary in the image, away from the nearer surface."""
    near_face: Int[Tensor, " S"]
    near_weights: Float[Tensor, "S 3"]
    """Barycentric; a quarter of a pixel inside of the boundary."""
    far_face: Int[Tensor, " S"]
    far_weights: Float[Tensor, "S 3"]
    """The same outside of it."""

    def outward_motion(self, positions: Float[Tensor, "V 3"], photographs: ViewPhotographs) -> Float[Tensor, " S"]:
        """Zeros, with the derivative of the motion of each sample along `outward`, in pixels."""
        a, b = positions.double()[self.ends].unbind(1)
        points = a + self.fraction[:, None] * (b - a)
        view = torch.tensor(self.views, device=positions.device)[self.row]
        along = (photographs.project(points, view) * self.outward).sum(dim=1)
        return along - along.detach()


def find_boundaries(
    mesh: Mesh, edges: EdgeFaces, photographs: ViewPhotographs, views: Sequence[int], tracer: MeshQueries
) -> BoundarySamples:
    """Samples of all occlusion boundaries of the named views, without gradient.

    `tracer` finds the surfaces on both sides; one of slightly other positions will do.
    """
    positions = mesh.positions.detach().double()
    row, edge = _contours(positions, mesh.faces, edges, photographs.centers[list(views)])
    view = torch.tensor(views, device=positions.device)[row]
    ends = edges.ends[edge]
    a, b = (photographs.project(positions[ends[:, k]], view) for k in (0, 1))
    length = (b - a).norm(dim=1)
    drawn = torch.isfinite(length) & (length > 0)
    row, ends, a, b, length = row[drawn], ends[drawn], a[drawn], b[drawn], length[drawn]
    count = (length / SAMPLE_SPACING_PIXELS).ceil().clamp(1, SAMPLES_PER_EDGE_MAX).long()
    piece = torch.repeat_interleave(torch.arange(len(count), device=count.device), count)
    index = torch.arange(len(piece), device=count.device) - (torch.cumsum(count, 0) - count)[piece]
    # of the edge in space, whose midpoint is not that of its picture: the difference is below a pixel
    fraction = (index + 0.5).double() / count[piece]
    row, ends = row[piece], ends[piece]
    view = torch.tensor(views, device=positions.device)[row]
    points = torch.lerp(positions[ends[:, 0]], positions[ends[:, 1]], fraction[:, None])
    pixels = photographs.project(points, view)
    tangent = (b - a)[piece] / length[piece, None]
    normal = torch.stack([tangent[:, 1], -tangent[:, 0]], dim=1)
    distance = (points - photographs.centers[view]).norm(dim=1)
    sides = [_surface(mesh, photographs, view, pixels + s * BESIDE_PIXELS * normal, tracer) for s in (1, -1)]
    gap = LEAST_JUMP_PIXELS * distance * torch.tensor([photographs.pixel_angle(v) for v in views]).to(distance)[row]
    # the surface that ends at the edge is the first one on its side, and bends away; the other one lies behind both
    near = [((side.distance - distance) > -gap) & ((side.distance - distance) < 3 * gap) for side in sides]
    far = [torch.isfinite(side.distance) & (side.distance > distance + gap) for side in sides]
    first = near[0] & far[1] & (sides[1].distance > sides[0].distance + gap)
    second = near[1] & far[0] & (sides[0].distance > sides[1].distance + gap) & ~first
    kept = first | second

    def chosen(name: str, nearer: bool) -> Tensor:
        one, other = (getattr(side, name) for side in (sides if nearer else sides[::-1]))
        is_first = first if one.ndim == 1 else first[:, None]
        return torch.where(is_first, one, other)[kept]

    return BoundarySamples(
        views=views,
        row=row[kept],
        ends=ends[kept],
        fraction=fraction[kept],
        length=(length[piece] / count[piece])[kept],
        pixels=pixels[kept],
        outward=torch.where(first[:, None], -normal, normal)[kept],
        near_face=chosen("face", True),
        near_weights=chosen("weights", True),
        far_face=chosen("face", False),
        far_weights=chosen("weights", False),
    )


def _contours(
    positions: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"], edges: EdgeFaces, centers: Float[Tensor, "B 3"]
) -> tuple[Int[Tensor, " C"], Int[Tensor, " C"]]:
    """Row of the view and edge of every contour: between a face towards the camera and one away, or open."""
    a, b, c = positions[faces].unbind(1)
    normals = torch.linalg.cross(b - a, c - a)
    towards = normals @ centers.T - (normals * a).sum(dim=1, keepdim=True) > 0
    towards = torch.cat([towards, torch.zeros_like(towards[:1])])
    contour = towards[edges.faces[:, 0]] != towards[edges.faces[:, 1]]
    contour |= edges.faces[:, 1:] == len(faces)
    edge, row = contour.nonzero(as_tuple=True)
    return row, edge


@dataclass(frozen=True, eq=False)
class _Surface:
    face: Int[Tensor, " S"]
    weights: Float[Tensor, "S 3"]
    distance: Float[Tensor, " S"]
    """Infinite for a miss."""


def _surface(
    mesh: Mesh, photographs: ViewPhotographs, view: Int[Tensor, " S"], pixels: Float[Tensor, "S 2"], tracer: MeshQueries
) -> _Surface:
    """What the rays through `pixels` hit first."""
    numbers, at = view.cpu().numpy(), pixels.cpu().numpy()
    origins, directions = np.empty((2, len(at), 3), np.float32)
    for number in np.unique(numbers):
        rows = numbers == number
        origins[rows], directions[rows] = photographs.cameras[int(number)].rays(at[rows])
    found: tuple[NDArray[np.int64], NDArray[np.float32]] = tracer.first_hits(origins, directions)
    device = mesh.positions.device
    face, weights = torch.from_numpy(found[0]).to(device), torch.from_numpy(found[1]).to(device)
    hit = face >= 0
    corners = mesh.positions.detach()[mesh.faces[face.clamp_min(0)]].double()
    points = (corners * weights[..., None]).sum(dim=1)
    distance = (points - photographs.centers[view]).norm(dim=1)
    return _Surface(face.clamp_min(0), weights, torch.where(hit, distance, torch.inf))
