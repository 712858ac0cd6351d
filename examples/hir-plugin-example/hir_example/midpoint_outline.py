"""A geometry renderer of one page: values by counting samples, gradients from the outline.

The area of a silhouette moves only where its outline does: `dA = Σ v·n l` over the edges of the outline, v the motion
of an edge's point, n its normal, l its length in pixels. The intersection with a mask M moves by `Σ M v·n l`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np
import torch
from torch import Tensor

from hir_core.capture import Camera, View
from hir_core.plugins.interfaces import GeometryRenderer
from hir_core.scene import Mesh
from hir_core.scene.silhouette_targets import SilhouetteTargets
from hir_example.options import MidpointOptions

NEAR = 1e-3
"""Triangles with a corner nearer than this share of the farthest depth are ignored."""


@final
class MidpointOutline(GeometryRenderer):
    """Exact to the samples a pixel; the outline is the edges between a face towards the camera and one away from it."""

    def __init__(self, config: MidpointOptions) -> None:
        self._samples = max(1, config.samples)

    def prepare(self, views: Sequence[View], downsample: int = 1) -> SilhouetteTargets:
        """The masks as they are."""
        return SilhouetteTargets.from_views(views, downsample)

    def render(self, mesh: Mesh, cameras: Sequence[Camera]) -> Tensor:
        """Share of covered samples of each pixel; views smaller than the largest are padded with 0."""
        height = max((camera.height for camera in cameras), default=0)
        width = max((camera.width for camera in cameras), default=0)
        image = mesh.positions.new_zeros(len(cameras), height, width)
        for i, camera in enumerate(cameras):
            covered, _, _ = self._seen(mesh, camera)
            image[i, : camera.height, : camera.width] = self._pixels(covered, camera).to(image)
        return image

    def overlap(self, mesh: Mesh, targets: SilhouetteTargets) -> tuple[Tensor, Tensor]:
        """Area and intersection of each view in pixels, with the outline's derivative."""
        areas, overlaps = [], []
        for camera, mask in zip(targets.cameras, targets.masks, strict=True):
            covered, pixels, facing = self._seen(mesh, camera)
            coverage = self._pixels(covered, camera)
            on_mask = mask.cpu().double()
            moved, weight = self._outline(mesh, pixels, facing, covered, on_mask)
            areas.append(coverage.sum() + moved.sum())
            overlaps.append((coverage * on_mask).sum() + (moved * weight).sum())
        empty = mesh.positions.new_zeros(0)
        to = mesh.positions.device
        return (torch.stack(areas).to(to), torch.stack(overlaps).to(to)) if areas else (empty, empty)

    def _seen(self, mesh: Mesh, camera: Camera) -> tuple[Tensor, Tensor, Tensor]:
        """Covered samples (H·s, W·s), the vertices in pixels (V, 2), and each face's side: 1, −1, or 0 for left out."""
        pose = torch.from_numpy(camera.world_to_camera).double()
        local = mesh.positions.cpu().double() @ pose[:3, :3].T + pose[:3, 3]
        depth = local[:, 2]
        near = NEAR * float(depth.detach().amax()) if len(depth) else 1.0
        safe = torch.where(depth > max(near, 1e-12), depth, 1.0)
        pixels = (local @ torch.from_numpy(camera.intrinsics).double().T)[:, :2] / safe[:, None]
        faces = mesh.faces.cpu()
        corners = pixels.detach()[faces]
        across = (corners[:, 1] - corners[:, 0])[:, 0] * (corners[:, 2] - corners[:, 0])[:, 1]
        across = across - (corners[:, 1] - corners[:, 0])[:, 1] * (corners[:, 2] - corners[:, 0])[:, 0]
        front = (depth.detach()[faces] > max(near, 1e-12)).all(dim=1)
        facing = torch.sign(across) * front
        shape = (camera.height * self._samples, camera.width * self._samples)
        return covered_samples(corners[facing != 0].numpy(), shape, self._samples), pixels, facing

    def _pixels(self, covered: Tensor, camera: Camera) -> Tensor:
        side = self._samples
        return covered.double().reshape(camera.height, side, camera.width, side).mean(dim=(1, 3))

    def _outline(
        self, mesh: Mesh, pixels: Tensor, facing: Tensor, covered: Tensor, mask: Tensor
    ) -> tuple[Tensor, Tensor]:
        """For pieces of the outline of about a pixel: 0 with the derivative of the area, and the mask beside them."""
        edge, face = (index.cpu() for index in mesh.topology.edge_faces)
        count = len(mesh.topology.edges)
        # an edge is on the outline where all of its faces lie on one side of it
        third = mesh.faces.cpu()[face].sum(dim=1) - mesh.topology.edges.cpu()[edge].sum(dim=1)
        ends = mesh.topology.edges.cpu()
        a, b = pixels.detach()[ends[:, 0]], pixels.detach()[ends[:, 1]]
        along = b - a
        length = along.norm(dim=1).clamp_min(1e-12)
        normal = torch.stack([along[:, 1], -along[:, 0]], dim=1) / length[:, None]
        side = ((pixels.detach()[third] - a[edge]) * normal[edge]).sum(dim=1) * (facing[face] != 0)
        low = torch.zeros(count, dtype=side.dtype).scatter_reduce(0, edge, side, "amin")
        high = torch.zeros(count, dtype=side.dtype).scatter_reduce(0, edge, side, "amax")
        outer = ((low < 0) & (high <= 0)) | ((high > 0) & (low >= 0))
        normal = torch.where((high > 0)[:, None], -normal, normal)
        pieces = torch.where(outer & (length < 1e4), length.ceil().clamp(1, 64), 0).long()
        which = torch.repeat_interleave(torch.arange(count), pieces)
        within = torch.arange(len(which)) - (pieces.cumsum(0) - pieces)[which]
        t = ((within + 0.5) / pieces[which])[:, None]
        place = a[which] * (1 - t) + b[which] * t
        # hidden where a sample just outside is covered too
        open_side = ~_look_up(covered, (place + 0.75 / self._samples * normal[which]) * self._samples, fallback=False)
        inside = _look_up(torch.ones_like(covered), place * self._samples, fallback=False)
        moving = pixels[ends[which, 0]] * (1 - t) + pixels[ends[which, 1]] * t
        step = ((moving - moving.detach()) * normal[which]).sum(dim=1) * (length / pieces.clamp_min(1))[which]
        weight = 0.5 * sum(_look_up(mask, place + way * normal[which], fallback=0.0) for way in (-0.5, 0.5))
        return step * (open_side & inside), weight


def covered_samples(corners: np.ndarray, shape: tuple[int, int], samples: int) -> Tensor:
    """Samples (H, W) that a triangle (T, 3, 2) in pixels covers."""
    covered = np.zeros(shape, dtype=bool)
    scaled = corners * samples - 0.5
    low = np.clip(np.floor(scaled.min(axis=1)), 0, [shape[1], shape[0]]).astype(int)
    high = np.clip(np.ceil(scaled.max(axis=1)) + 1, 0, [shape[1], shape[0]]).astype(int)
    for (a, b, c), (x0, y0), (x1, y1) in zip(scaled, low, high, strict=True):
        if x0 >= x1 or y0 >= y1:
            continue
        x, y = np.arange(x0, x1)[None], np.arange(y0, y1)[:, None]
        sides = [(q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]) for p, q in ((a, b), (b, c), (c, a))]
        inside = (sides[0] >= 0) & (sides[1] >= 0) & (sides[2] >= 0)
        covered[y0:y1, x0:x1] |= inside | ((sides[0] <= 0) & (sides[1] <= 0) & (sides[2] <= 0))
    return torch.from_numpy(covered)


def _look_up(image: Tensor, place: Tensor, fallback: float | bool) -> Tensor:
    """The value of the cell that contains (x, y); `fallback` outside the picture."""
    x, y = place.floor().long().unbind(1)
    inside = (x >= 0) & (y >= 0) & (x < image.shape[1]) & (y < image.shape[0])
    found = image[y.clamp(0, image.shape[0] - 1), x.clamp(0, image.shape[1] - 1)]
    return torch.where(inside, found, torch.full_like(found, fallback))
