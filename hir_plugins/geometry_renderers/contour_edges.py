"""Exact outlines of projected triangles: which parts of which mesh edges bound the silhouette.

Orient every projected triangle positively and add up the boundaries. An edge between two triangles on opposite sides
of it cancels. The edges that remain have all triangles on one side, or are open or non-manifold; each has a
multiplicity. Along any line through the image, the sum of the multiplicities passed so far is the number of triangles
that cover the point, at any depth. The outline is where this number leaves or reaches zero. This needs no rays and no
offset, and the mesh need not be closed, oriented or manifold: the count is an integer and ends at zero on every line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from hir_core.capture import Camera
from hir_core.scene import Topology

TIE_PIXELS = 1e-4
"""Spans begin this much earlier and end later in the order along a line: gaps of float32 width, at T-junctions and
between duplicated vertices, stay closed."""

FACES_AT_ONCE = 8192
"""On a CPU, for the side of each face that each camera sees: float64 values of so few stay in its cache."""

NEAR_DEPTH = 1e-6
"""Triangles are cut at this depth, as a fraction of the largest depth in the view."""


@dataclass(frozen=True, eq=False)
class EdgeTable:
    """For each edge, lower vertex first, the face that runs along it and the face that runs against it."""

    corners: Int[Tensor, "3 F"]
    """Vertices of the faces."""
    ends: Int[Tensor, "E 2"]
    along: Int[Tensor, " E"]
    """Index F where there is none; so below."""
    against: Int[Tensor, " E"]
    extra: tuple[Int[Tensor, " M"], Int[Tensor, " M"], Int[Tensor, " M"]]
    """Edge, face and direction, +1 or −1, of further faces of non-manifold edges and of faces that are not oriented
    alike."""

    @classmethod
    def of(cls, topology: Topology) -> EdgeTable:
        """Builds the table: once for each topology, because it is too slow for every step."""
        faces = topology.faces
        corners = torch.cat([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        corners = corners[corners[:, 0] != corners[:, 1]]
        against = (corners[:, 0] > corners[:, 1]).long()
        edge, face = topology.edge_faces
        place = 2 * edge + against
        order = torch.argsort(place, stable=True)
        place, face = place[order], face[order]
        table = torch.full((2 * len(topology.edges),), len(faces), dtype=torch.int64, device=faces.device)
        first = torch.ones_like(place, dtype=torch.bool)
        first[1:] = place[1:] != place[:-1]
        table[place[first]] = face[first]
        further = place[~first]
        extra = further // 2, face[~first], (1 - 2 * (further % 2)).to(torch.int8)
        return cls(faces.T.contiguous(), topology.edges, table[0::2].contiguous(), table[1::2].contiguous(), extra)


@dataclass(frozen=True, eq=False)
class CameraBatch:
    """Cameras as float64 tensors on the device of the mesh."""

    projection: Float[Tensor, "B 3 4"]
    """Intrinsics times pose."""
    centers: Float[Tensor, "B 3"]
    widths: Int[Tensor, " B"]
    heights: Int[Tensor, " B"]
    handedness: Int[Tensor, " B"]
    """−1 for a mirrored camera, where a front face runs the other way round."""
    distortion: Float[Tensor, "B 5"]
    normalized: Float[Tensor, "B 3 4"]
    """The pose alone: what distortion acts on."""
    intrinsics: Float[Tensor, "B 3 3"]

    @classmethod
    def of(cls, cameras: Sequence[Camera], device: torch.device) -> CameraBatch:
        """Composes in float64, which keeps sub-pixel accuracy for a scene far from the origin."""
        poses = np.stack([np.asarray(c.world_to_camera, dtype=np.float64)[:3] for c in cameras])
        intrinsics = np.stack([np.asarray(c.intrinsics, dtype=np.float64) for c in cameras])
        coefficients = np.zeros((len(cameras), 5))
        for row, camera in zip(coefficients, cameras, strict=True):
            row[: min(5, len(camera.distortion))] = camera.distortion[:5]
        hand = np.sign(np.linalg.det(intrinsics) * np.linalg.det(poses[:, :, :3]))

        def tensor(array: object, dtype: torch.dtype = torch.float64) -> Tensor:
            return torch.as_tensor(np.asarray(array), dtype=dtype, device=device)

        return cls(
            projection=tensor(intrinsics @ poses),
            centers=tensor(np.stack([np.asarray(c.center, dtype=np.float64) for c in cameras])),
            widths=tensor([c.width for c in cameras], torch.int64),
            heights=tensor([c.height for c in cameras], torch.int64),
            handedness=tensor(hand, torch.int8),
            distortion=tensor(coefficients),
            normalized=tensor(poses),
            intrinsics=tensor(intrinsics),
        )

    def project(self, points: Float[Tensor, "N 3"], view: Int[Tensor, " N"]) -> Float[Tensor, "N 2"]:
        """Pixels of points in front of their cameras.

        Products and sums are evaluated element by element: equal inputs give bitwise equal outputs at any index of the
        batch, so that the count of every line ends at zero. A matrix product does not guarantee that.
        """
        if bool((self.distortion != 0).any()):
            return self._project_distorted(points, view)
        rows = self.projection.reshape(-1, 12).index_select(0, view).reshape(-1, 3, 4)
        x, y, w = (_dot(rows[:, i], points) for i in range(3))
        return torch.stack([x / w, y / w], dim=1)

    def depths(self, points: Float[Tensor, "V 3"]) -> Float[Tensor, "V B"]:
        """Distance along each camera's axis."""
        return points @ self.projection[:, 2, :3].T + self.projection[:, 2, 3]

    def all_see_front(self, axes: Float[Tensor, "3 V"]) -> bool:
        """Whether the bounding box of the points lies in front of every camera, well beyond the near plane."""
        low, high = axes.aminmax(dim=1)
        box = torch.cartesian_prod(*torch.stack([low, high], dim=1))
        depth = self.depths(box)
        return bool((depth.amin(0) > 2 * NEAR_DEPTH * depth.amax(0)).all())

    def _project_distorted(self, points: Tensor, view: Tensor) -> Tensor:
        rows = self.normalized[view]
        x, y, w = (_dot(rows[:, i], points) for i in range(3))
        x, y = x / w, y / w
        k1, k2, p1, p2, k3 = self.distortion[view].unbind(1)
        # beyond this radius the polynomial is invalid and may fold back; such points lie outside the frame
        r2 = (x * x + y * y).clamp_max(4.0)
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        k = self.intrinsics[view]
        return torch.stack(
            [k[:, 0, 0] * xd + k[:, 0, 1] * yd + k[:, 0, 2], k[:, 1, 0] * xd + k[:, 1, 1] * yd + k[:, 1, 2]], dim=1
        )


def _dot(row: Tensor, points: Tensor) -> Tensor:
    return row[:, 0] * points[:, 0] + row[:, 1] * points[:, 1] + row[:, 2] * points[:, 2] + row[:, 3]


@dataclass(frozen=True, eq=False)
class Segments:
    """The edges that do not cancel, in every view, with their multiplicity."""

    view: Int[Tensor, " N"]
    ends: Int[Tensor, "N 2"]
    """Into the vertices, then the cuts."""
    winding: Int[Tensor, " N"]
    cut_edges: Int[Tensor, "C 2"]
    """Edges that pass through a camera's near plane; the cut lies `cut_at` of the way along."""
    cut_at: Float[Tensor, " C"]

    def points(self, positions: Float[Tensor, "V 3"]) -> Float[Tensor, "V+C 3"]:
        """Vertices and cuts; differentiable. A cut keeps its fraction along the edge and stays on the same line."""
        if len(self.cut_at) == 0:
            return positions
        a, b = positions[self.cut_edges].unbind(1)
        return torch.cat([positions, a + self.cut_at[:, None].to(positions) * (b - a)])


def find_segments(
    positions: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"], table: EdgeTable, cameras: CameraBatch
) -> Segments:
    """All edges that may bound the silhouette, in float64, without gradient.

    Which side of a triangle is seen follows from its plane and the camera's centre: one matrix product for all views.
    It can be wrong by rounding only for a sliver thinner than the rounding error, and the count stays an integer.
    """
    axes = positions.T.contiguous()
    sign = _seen_sides(axes, table.corners, cameras)
    cuts = None
    if len(positions) and not cameras.all_see_front(axes):
        depth = cameras.depths(positions)
        near = depth.amax(0).clamp_min(torch.finfo(depth.dtype).tiny) * NEAR_DEPTH
        behind = depth <= near
        corners_behind = behind[faces].sum(1)
        straddling = (corners_behind > 0) & (corners_behind < 3) & (sign[:-1] != 0)
        cuts = _cut_triangles(faces, depth, near, straddling, sign, len(positions))
        sign[:-1] *= corners_behind == 0
    # index_select is several times faster than indexing for rows of a few bytes
    winding = sign.index_select(0, table.along).sub_(sign.index_select(0, table.against))
    edge, face, direction = table.extra
    if len(edge):
        winding.index_add_(0, edge, sign[face] * direction[:, None])
    found = winding.reshape(-1).nonzero()[:, 0]
    edges = found // max(1, winding.shape[1])
    segments = Segments(
        found - edges * winding.shape[1],
        table.ends.index_select(0, edges),
        winding.reshape(-1).index_select(0, found).to(torch.int64),
        table.ends.new_zeros((0, 2)),
        positions.new_zeros(0),
    )
    return segments if cuts is None else _joined(segments, cuts)


def _seen_sides(axes: Float[Tensor, "3 V"], corners: Int[Tensor, "3 F"], cameras: CameraBatch) -> Int[Tensor, "F+1 B"]:
    """1 where a camera sees the front of a face, −1 where it sees the back, 0 for a face without area or in profile;
    a row of zeros follows. int8.
    """
    # each component is an array of its own: arithmetic on these takes a third of the time of (F, 3) arrays
    a, b, c = ([axis.index_select(0, corner) for axis in axes] for corner in corners)
    u, v = ([q - p for p, q in zip(a, ends, strict=True)] for ends in (b, c))
    pairs = (1, 2), (2, 0), (0, 1)
    normals = torch.stack([torch.addcmul(u[i] * v[j], u[j], v[i], value=-1) for i, j in pairs])
    level = torch.addcmul(torch.addcmul(normals[0] * a[0], normals[1], a[1]), normals[2], a[2])
    count, views = corners.shape[1], len(cameras.centers)
    sign = torch.zeros((count + 1, views), dtype=torch.int8, device=axes.device)
    centers = cameras.centers.T.contiguous()
    at_once = FACES_AT_ONCE if axes.device.type == "cpu" else max(1, count)
    for start in range(0, count, at_once):
        part = slice(start, min(start + at_once, count))
        side = torch.addmm(level[part, None].expand(-1, views), normals[:, part].T, centers, beta=-1)
        sign[part] = side.sign_().to(torch.int8) * cameras.handedness
    return sign


def _joined(a: Segments, b: Segments) -> Segments:
    return Segments(
        torch.cat([a.view, b.view]),
        torch.cat([a.ends, b.ends]),
        torch.cat([a.winding, b.winding]),
        b.cut_edges,
        b.cut_at,
    )


def _cut_triangles(
    faces: Tensor, depth: Tensor, near: Tensor, straddling: Tensor, sign: Tensor, vertices: int
) -> Segments:
    """The parts of straddling triangles in front of the near plane, each as the closed boundary of a polygon."""
    face, view = straddling.nonzero(as_tuple=True)
    corners = faces[face]
    corner_depth = depth[corners, view[:, None]]
    front = corner_depth > near[view][:, None]
    # turn each triangle until its odd corner (the only one in front, or the only one behind) comes first
    odd = torch.where(front.sum(1) == 1, 1, 0).bool()
    lone = (front == odd[:, None]).to(torch.int8).argmax(1)
    turn = (torch.arange(3, device=faces.device)[None] + lone[:, None]) % 3
    corners = corners.gather(1, turn)
    corner_depth = corner_depth.gather(1, turn)
    first, second, third = corners.unbind(1)
    edges = torch.stack([torch.stack([first, second], 1), torch.stack([first, third], 1)], 1).reshape(-1, 2)
    d0 = corner_depth[:, [0, 0]].reshape(-1)
    d1 = corner_depth[:, [1, 2]].reshape(-1)
    level = near[view].repeat_interleave(2)
    at = (level - d0) / (d1 - d0)
    cut = vertices + torch.arange(len(edges), device=faces.device).reshape(-1, 2)
    ab, ac = cut.unbind(1)
    # odd corner in front: a, ab, ac; odd corner behind: ab, b, c, ac
    one = torch.stack([torch.stack([first, ab], 1), torch.stack([ab, ac], 1), torch.stack([ac, first], 1)], 1)[odd]
    two = torch.stack(
        [
            torch.stack([ab, second], 1),
            torch.stack([second, third], 1),
            torch.stack([third, ac], 1),
            torch.stack([ac, ab], 1),
        ],
        1,
    )[~odd]
    directions = sign[face, view].to(torch.int64)
    return Segments(
        torch.cat([view[odd].repeat_interleave(3), view[~odd].repeat_interleave(4)]),
        torch.cat([one.reshape(-1, 2), two.reshape(-1, 2)]),
        torch.cat([directions[odd].repeat_interleave(3), directions[~odd].repeat_interleave(4)]),
        edges,
        at,
    )
