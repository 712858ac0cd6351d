"""Measured depths as a term of the geometry fit: they hold the surface where no outline does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from hir_core.capture import View
from hir_core.capture.depth_samples import depth_noise, usable_depths
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.scene import Mesh

MAX_RAYS: Final = 400_000
"""Kept of all depth maps, a random sample of each."""

RAYS_PER_STEP: Final = 4_000

OUTLIER_DISTANCE: Final = 0.05
"""Share of the object's radius at which a depth pulls at most half as strongly as the square of its distance would."""

OUTLIER_NOISE: Final = 3.0
"""The same in standard deviations of the depths' noise; the larger of both counts."""


@dataclass(frozen=True, eq=False)
class DepthRays:
    """Rays of the depth maps' pixels, and where they ended."""

    origins: NDArray[np.float32]
    """(N, 3)."""
    directions: NDArray[np.float32]
    """(N, 3), of length 1."""
    points: NDArray[np.float32]
    """(N, 3)."""
    weights: NDArray[np.float32]
    """(N,): confidence, times the share of the views that have a depth map."""
    outlier_distance: float

    def energy(self, mesh: Mesh, step: int) -> Float[Tensor, ""]:
        """Robust mean square of the distances (Geman & McClure 1985) of a batch of the rays, in the mesh's unit."""
        batches = max(1, len(self.points) // RAYS_PER_STEP)
        distance, weight = self._distances(mesh, slice(step % batches, None, batches))
        square, scale = distance.square(), self.outlier_distance**2
        return (weight * square * scale / (square + scale)).sum() / max(1, len(distance))

    def median_distance(self, mesh: Mesh) -> float:
        """Median over all rays, in the mesh's unit."""
        with torch.no_grad():
            distance, _ = self._distances(mesh, slice(None))
        return float(distance.abs().median()) if len(distance) else float("nan")

    def _distances(self, mesh: Mesh, batch: slice) -> tuple[Float[Tensor, " M"], Float[Tensor, " M"]]:
        """Of the measured points from the planes of the triangles that their rays hit, and weights; without misses."""
        positions, faces = mesh.positions, mesh.faces
        queries = MeshQueries(positions.detach().cpu().numpy(), faces.cpu().numpy())
        face, barycentric = queries.first_hits(self.origins[batch], self.directions[batch])
        hit = face >= 0

        def tensor(values: NDArray[np.float32]) -> Tensor:
            return torch.from_numpy(np.ascontiguousarray(values[hit])).to(positions)

        corners = positions[faces[torch.from_numpy(face[hit]).to(faces.device)]]
        reached = (corners * tensor(barycentric)[..., None]).sum(dim=1)
        normal = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        # without gradient: triangles turned aside would lower the distance without moving towards the point
        normal = (normal / normal.norm(dim=1, keepdim=True).clamp_min(1e-12)).detach()
        distance = ((reached - tensor(self.points[batch])) * normal).sum(dim=1)
        return distance, tensor(self.weights[batch])


def depth_rays(views: Sequence[View], radius: float, seed: int) -> DepthRays | None:
    """The rays of all depth maps of the views, of an object of that radius; None where there is no usable depth."""
    random = np.random.default_rng(seed)
    measured = [found for view in views if (found := view.measured_depth()) is not None]
    origins, directions, points, weights, noises = [], [], [], [], []
    for camera, pixels in measured:
        noise = depth_noise(pixels)
        rows, columns = np.nonzero(usable_depths(camera, pixels, noise))
        kept = np.sort(random.permutation(len(rows))[: MAX_RAYS // len(measured)])
        rows, columns = rows[kept], columns[kept]
        origin, direction = camera.rays(np.stack([columns, rows], axis=1) + 0.5)
        along = direction / np.linalg.norm(direction, axis=1, keepdims=True)
        length = pixels.depth[rows, columns] / (along @ camera.world_to_camera[2, :3])
        origins.append(np.broadcast_to(origin, along.shape))
        directions.append(along)
        points.append(origins[-1] + along * length[:, None])
        weights.append(pixels.confidence[rows, columns] * (len(measured) / len(views)))
        noises.append(noise)
    if not sum(len(each) for each in points):
        return None
    order = random.permutation(sum(len(each) for each in points))
    start, along, end, weight = (
        np.concatenate(each).astype(np.float32)[order] for each in (origins, directions, points, weights)
    )
    outlier_distance = max(OUTLIER_DISTANCE * radius, OUTLIER_NOISE * float(np.median(noises)))
    return DepthRays(start, along, end, weight, outlier_distance)
