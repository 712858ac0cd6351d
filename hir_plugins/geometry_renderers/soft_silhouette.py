"""Soft Rasterizer's silhouettes (Liu et al. 2019, equations 1 and 2), as the paper's phase 2a renders them.

`S = 1 − Π_j (1 − D_j)`, `D_j = sigmoid(δ_j d_j² / σ)`: every triangle near a pixel contributes, also hidden triangles
and those that face away. The image is evaluated in small tiles; a tile is skipped only where its value is proven.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, final

import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.capture import Camera, View
from hir_core.plugins.interfaces import GeometryRenderer
from hir_core.scene import Mesh
from hir_core.scene.silhouette_targets import SilhouetteTargets
from hir_plugins.geometry_renderers.contour import Contour
from hir_plugins.geometry_renderers.contour_edges import NEAR_DEPTH, CameraBatch
from hir_plugins.geometry_renderers.options import ContourOptions, SoftSilhouetteOptions
from hir_plugins.geometry_renderers.soft_tiles import Kernel, Tiles, accumulate, gather_tiles, gradient


@final
class SoftSilhouette(GeometryRenderer):
    """The blurred coverage of all triangles. A triangle with a corner behind the camera is left out, as in SoftRas."""

    def __init__(self, config: SoftSilhouetteOptions) -> None:
        self._config = config
        self._contour = Contour(ContourOptions())

    def prepare(self, views: Sequence[View], downsample: int = 1) -> SilhouetteTargets:
        return SilhouetteTargets.from_views(views, downsample)

    def render(self, mesh: Mesh, cameras: Sequence[Camera]) -> Float[Tensor, "B H W"]:
        """S at the centres of the pixels; views smaller than the largest are padded with 0."""
        if not cameras:
            return mesh.positions.new_zeros((0, 0, 0))
        batch = CameraBatch.of(cameras, mesh.positions.device)
        band = self._band(mesh, cameras) if self._config.band > 0 else None
        images = [self._one(mesh, batch, i, None if band is None else band[i]) for i in range(len(cameras))]
        height, width = max(c.height for c in cameras), max(c.width for c in cameras)
        return torch.stack(
            [torch.nn.functional.pad(i, (0, width - i.shape[1], 0, height - i.shape[0])) for i in images]
        )

    def overlap(self, mesh: Mesh, targets: SilhouetteTargets) -> tuple[Float[Tensor, " B"], Float[Tensor, " B"]]:
        """`Σ S` and `Σ M S` over the pixels of each view (Zhu et al. 2023, L_sil)."""
        if len(targets) == 0:
            return mesh.positions.new_zeros(0), mesh.positions.new_zeros(0)
        coverage = self.render(mesh, targets.cameras)
        area = coverage.sum(dim=(1, 2))
        shared = [
            (image[: mask.shape[0], : mask.shape[1]] * mask.to(image)).sum()
            for image, mask in zip(coverage, targets.masks, strict=True)
        ]
        return area, torch.stack(shared)

    def _one(self, mesh: Mesh, cameras: CameraBatch, view: int, band: Tensor | None) -> Float[Tensor, "H W"]:
        height, width = int(cameras.heights[view]), int(cameras.widths[view])
        # σ is in units of half the longer side
        unit = 2.0 / max(height, width)
        kernel = Kernel(self._config.sigma / unit**2, self._config.cutoff, self._config.tile)
        positions = mesh.positions.double()
        depth = cameras.depths(positions.detach())[:, view]
        near = depth.amax().clamp_min(0) * NEAR_DEPTH if len(depth) else depth.new_zeros(())
        front = (depth > near)[mesh.faces].all(dim=1)
        safe = torch.where((depth > near)[:, None], positions, positions.detach() * 0 + _ahead(cameras, view))
        index = torch.full((len(positions),), view, device=positions.device)
        pixels = cameras.project(safe, index).to(mesh.positions.dtype)
        triangles = pixels[mesh.faces[front]]
        return _SoftCoverage.apply(triangles, height, width, kernel, band)  # type: ignore[no-any-return,no-untyped-call]

    def _band(self, mesh: Mesh, cameras: Sequence[Camera]) -> Tensor:
        """Pixels near the exact outline, for each view."""
        with torch.no_grad():
            coverage = self._contour.render(mesh, cameras)
            # a pixel is on the outline where its neighbourhood has both covered and uncovered pixels
            size = 2 * self._config.band + 1
            most = torch.nn.functional.max_pool2d(coverage[:, None], size, 1, self._config.band)[:, 0]
            least = -torch.nn.functional.max_pool2d(-coverage[:, None], size, 1, self._config.band)[:, 0]
            return (most > 0.5) & (least < 0.5)


def _ahead(cameras: CameraBatch, view: int) -> Tensor:
    """A point in front of the camera, which replaces corners behind it to avoid a division by zero."""
    pose = cameras.normalized[view]
    return cameras.centers[view] + pose[2, :3]


class _SoftCoverage(torch.autograd.Function):
    """S from triangles in pixels; the backward pass evaluates the same tiles again; only their lists are stored."""

    @staticmethod
    def forward(ctx: Any, triangles: Tensor, height: int, width: int, kernel: Kernel, band: Tensor | None) -> Tensor:
        tiles = gather_tiles(triangles.detach(), height, width, kernel, band)
        absence = accumulate(triangles.detach(), tiles, kernel)
        ctx.save_for_backward(triangles, absence)
        ctx.tiles, ctx.kernel = tiles, kernel
        return tiles.to_image(1 - torch.exp(absence), full=1.0)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None, None, None, None]:  # type: ignore[override]
        triangles, absence = ctx.saved_tensors
        tiles: Tiles = ctx.tiles
        # dS/d(log Π(1 − D)) = −Π(1 − D)
        weight = -torch.exp(absence) * tiles.from_image(upstream)
        return gradient(triangles, tiles, ctx.kernel, weight), None, None, None, None
