"""Photo-consistency: a point of the surface must show the same detail in every view that sees it.

The residuals compare detail images (`detail_images`) between neighbouring views at points of the mesh. Only views of
one take are compared: under another light the shading has another detail.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import normalize

from hir_core.capture import Camera
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.scene import Mesh
from hir_core.stages.geometry.photo_consistency.detail_images import DetailImages

NEIGHBOURS_PER_VIEW = 8

LEAST_ANGLE_DEG, MOST_ANGLE_DEG = 4.0, 45.0
"""Between views with a smaller angle there is no parallax; with a larger one a surface looks too different."""

LEAST_COSINE = 0.2
"""Cosine between normal and view direction below which a view sees a facet too obliquely to compare."""

SHADOW_RAY_OFFSET = 1e-3
"""Distance of the shadow rays' origins from the surface, as a fraction of the object's radius of 1."""


def neighbouring_views(cameras: Sequence[Camera], allowed: Sequence[int], takes: Sequence[int] = ()) -> list[list[int]]:
    """For each view the `allowed` ones of its take at the smallest usable angle, seen from the origin, nearest first.

    `takes` has the number of each view's take; without it all are of one.
    """
    centers = np.stack([camera.center for camera in cameras])
    directions = centers / np.maximum(np.linalg.norm(centers, axis=1, keepdims=True), 1e-30)
    angles = np.degrees(np.arccos(np.clip(directions @ directions.T, -1, 1)))
    neighbours = []
    for i in range(len(cameras)):
        comparable = {j for j in allowed if j != i and (not takes or takes[j] == takes[i])}
        by_angle = [j for j in np.argsort(angles[i], kind="stable") if j in comparable]
        usable = [int(j) for j in by_angle if LEAST_ANGLE_DEG < angles[i, j] < MOST_ANGLE_DEG]
        neighbours.append(usable[:NEIGHBOURS_PER_VIEW])
    return neighbours


@dataclass(frozen=True, eq=False)
class PixelPairs:
    """Pixels of some views, each with another view in which the same point of the surface is looked up."""

    view: NDArray[np.int64]
    other: NDArray[np.int64]
    pixel: NDArray[np.int64]
    """(P, 2): x, y in `view`."""


def sample_pairs(
    details: DetailImages,
    neighbours: Sequence[Sequence[int]],
    views: Sequence[int],
    count: int,
    generator: np.random.Generator,
) -> PixelPairs:
    """About `count` pixels of each of the named views, drawn at random, each with a random neighbour."""
    parts: list[tuple[NDArray[np.int64], ...]] = []
    for view in views:
        pixels = details.pixels[view]
        if len(pixels) == 0 or not neighbours[view]:
            continue
        chosen = pixels[generator.integers(len(pixels), size=count)]
        others = generator.choice(np.array(neighbours[view]), size=count)
        parts.append((np.full(count, view), others, chosen.astype(np.int64)))
    if not parts:
        empty = np.empty(0, np.int64)
        return PixelPairs(empty, empty, empty.reshape(0, 2))
    return PixelPairs(*(np.concatenate([part[k] for part in parts]) for k in range(3)))


def photo_consistency_residuals(
    mesh: Mesh, details: DetailImages, pairs: PixelPairs, tracer: MeshQueries | None = None
) -> tuple[Float[Tensor, "Q 3"], NDArray[np.int64]]:
    """Detail in the other view minus detail at the pixel, for the pairs of which both views see the surface, and the
    rows of these pairs in `pairs`. Differentiable in the positions: a point slides along its pixel's ray as its facet
    moves.

    `tracer` decides which facet a pixel shows and which view is hidden; by default that of `mesh`. One of slightly
    other positions will do: points are where the rays meet the present planes of these facets.
    """
    positions = mesh.positions
    tracer = tracer or ray_structure(mesh)
    origins, directions = _rays(details.cameras, pairs)
    face, distance = tracer.first_faces_and_distances(origins, directions)
    rows = np.flatnonzero(face >= 0)
    device = positions.device
    origin, direction = (torch.from_numpy(a[rows]).to(positions) for a in (origins, directions))
    a, b, c = positions[mesh.faces[torch.from_numpy(face[rows]).to(device)]].unbind(1)
    normal = normalize(torch.linalg.cross(b - a, c - a), dim=1, eps=1e-30)
    cosine = (normal * direction).sum(1)
    facing = cosine.detach() < -LEAST_COSINE
    points = origin + ((normal * (a - origin)).sum(1) / torch.where(facing, cosine, -1.0))[:, None] * direction
    other = torch.from_numpy(pairs.other[rows]).to(device)
    with torch.no_grad():
        to_other = normalize(details.centers[other].to(positions) - points, dim=1, eps=1e-30)
        seen = facing & ((normal * to_other).sum(1) > LEAST_COSINE) & torch.isfinite(points).all(dim=1)
        # from the surface of the tracer: the present one may lie behind it
        hit = origin + torch.from_numpy(distance[rows, None]).to(positions) * direction
        start = torch.where(seen[:, None], hit + SHADOW_RAY_OFFSET * normal, 0.0).cpu().numpy()
        seen &= ~torch.from_numpy(tracer.occluded(start, to_other.cpu().numpy())).to(device)
    points, other, rows = points[seen], other[seen], rows[seen.cpu().numpy()]
    detail, within = _bilinear_detail(details, _project(details, points, other), other)
    rows = rows[within.cpu().numpy()]
    x, y = pairs.pixel[rows].T
    own = details.images[torch.from_numpy(pairs.view[rows]), torch.from_numpy(y), torch.from_numpy(x)]
    return detail - own.to(detail), rows


def ray_structure(mesh: Mesh) -> MeshQueries:
    """The acceleration structure of a mesh."""
    return MeshQueries(mesh.positions.detach().cpu().numpy(), mesh.faces.cpu().numpy())


def _rays(cameras: Sequence[Camera], pairs: PixelPairs) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    origins = np.empty((len(pairs.view), 3), np.float32)
    directions = np.empty((len(pairs.view), 3), np.float32)
    for view in np.unique(pairs.view):
        rows = pairs.view == view
        origins[rows], directions[rows] = cameras[int(view)].rays(pairs.pixel[rows].astype(np.float64) + 0.5)
    return origins, directions


def _project(details: DetailImages, points: Float[Tensor, "Q 3"], view: Int[Tensor, " Q"]) -> Float[Tensor, "Q 2"]:
    matrix = details.projections[view].to(points)
    homogeneous = (matrix[:, :, :3] @ points[..., None])[..., 0] + matrix[:, :, 3]
    depth = homogeneous[:, 2:]
    return homogeneous[:, :2] / torch.where(depth.abs() < 1e-12, 1e-12, depth)


def _bilinear_detail(
    details: DetailImages, pixels: Float[Tensor, "Q 2"], view: Int[Tensor, " Q"]
) -> tuple[Float[Tensor, "R 3"], Bool[Tensor, " Q"]]:
    """Bilinear detail at pixel coordinates (centres at .5), differentiable in them, and for which of them: those whose
    four pixels all lie inside the object.
    """
    _, height, width, _ = details.images.shape
    corner = (pixels.detach() - 0.5).floor()
    within = ((corner >= 0) & (corner < torch.tensor([width - 1, height - 1], device=pixels.device))).all(dim=1)
    x, y = torch.where(within[:, None], corner, 0.0).long().unbind(1)
    first = (view * height + y) * width + x
    within &= details.square_inside.view(-1)[first]
    pixels, x, y, first = pixels[within], x[within], y[within], first[within]
    fx, fy = (pixels - 0.5 - torch.stack([x, y], dim=1)).unbind(1)
    images = details.images.view(-1, 3)

    def at(step: int) -> Tensor:
        return images.index_select(0, first + step).to(pixels)

    top = at(0) * (1 - fx)[:, None] + at(1) * fx[:, None]
    bottom = at(width) * (1 - fx)[:, None] + at(width + 1) * fx[:, None]
    return top * (1 - fy)[:, None] + bottom * fy[:, None], within
