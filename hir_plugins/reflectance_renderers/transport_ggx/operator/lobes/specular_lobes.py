"""The GGX lobe of every pixel as rows of a sparse matrix on the light's pyramid.

Directions are drawn from the distribution of visible normals at one width α₀; another α changes only their weights. The
lobe is split as `specular = ρs·(W − G) + G` for Schlick's term and `ρs·W` for the paper's model, so both are linear in
ρs and the light.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy.typing import NDArray
from torch import Tensor

from hir_plugins.reflectance_renderers.brdf_torch import directional_albedo_terms, schlick_weight, specular_lobe
from hir_plugins.reflectance_renderers.ray_tracer import RayTracer
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_pyramid import Pyramid
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.metal_reflections import MetalSurface
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.spiral import spiral_points
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.traced_directions import (
    DirectionFrames,
    traced_lobes,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import SurfacePoints

SCALE_LIMITS = 0.5, 2.0
"""Of the factor that makes the weights of a lobe's directions add up to its albedo."""
MIN_EYE_COSINE = 1e-3
"""Least cosine between normal and eye: interpolated normals may face away from the camera at silhouettes."""


@dataclass(frozen=True, eq=False)
class Lobes:
    """K directions of each of P pixels, and the cosines from which their weights for any α follow."""

    columns: Int[Tensor, "P 4K"]
    """Texels of the flattened pyramid, or cache cells (numbered after the texels) where a direction hits the surface.
    """
    bilinear: Float[Tensor, "P 4K"]
    n_wi: Float[Tensor, "P K"]
    n_h: Float[Tensor, "P K"]
    sin2_h: Float[Tensor, "P K"]
    h_wo: Float[Tensor, "P K"]
    n_wo: Float[Tensor, " P"]
    inverse_pdf: Float[Tensor, "P K"]
    """1 / (K · density of the direction at `sampling_alpha`); 0 below the horizon."""
    sampling_alpha: Float[Tensor, "P 1"]
    """The α that the directions were drawn with."""
    toward_light: Float[Tensor, "P K 3"]
    """Unit directions, in `axes`."""
    toward_eye: Float[Tensor, "P 3"]
    axes: Float[Tensor, "P 3 3"]
    """Rows: tangent, bitangent and the normal that the directions were drawn about, in the world."""
    sources: int
    """Texels of the pyramid and cells together, for each number of reflections: the columns of the matrices."""

    def __len__(self) -> int:
        return len(self.columns)

    def take(self, rows: Tensor) -> Lobes:
        """The lobes of the pixels of `rows`."""
        return replace(self, **{name: getattr(self, name)[rows] for name in _PER_PIXEL})

    def weights(
        self, alpha: Float[Tensor, "#P 1"], normal: Float[Tensor, "P 3"] | None = None
    ) -> tuple[Float[Tensor, "P K"], Float[Tensor, "P K"]]:
        """Weight of every direction at width α, and that weight times Schlick's term; differentiable in α.

        `normal`: another shading normal, in `axes`, than the one about which directions were drawn.
        """
        if normal is None:
            lobe = specular_lobe(alpha, self.n_wi, self.n_wo[:, None], self.n_h, self.sin2_h)
        else:
            half = torch.nn.functional.normalize(self.toward_light + self.toward_eye[:, None], dim=-1, eps=1e-12)
            n_wi, n_h = (self.toward_light @ normal[..., None])[..., 0], (half @ normal[..., None])[..., 0]
            sin2_h = torch.linalg.cross(half, normal[:, None].expand_as(half)).square().sum(-1)
            lobe = specular_lobe(alpha, n_wi, self.cosine_of_eye(normal)[:, None], n_h, sin2_h)
        weight = lobe * self.inverse_pdf
        # a white light is integrated exactly at every width: few directions have an error of some per cent
        a, b = directional_albedo_terms(self.cosine_of_eye(normal)[:, None], alpha)
        scale = (a + b) / weight.sum(dim=1, keepdim=True).clamp_min(1e-6)
        weight = weight * scale.clamp(*SCALE_LIMITS)
        return weight, weight * schlick_weight(self.h_wo)

    def cosine_of_eye(self, normal: Float[Tensor, "P 3"] | None = None) -> Float[Tensor, " P"]:
        """Cosine between the eye and a normal in `axes`; by default the one about which directions were drawn."""
        return self.n_wo if normal is None else (self.toward_eye * normal).sum(dim=1).clamp_min(MIN_EYE_COSINE)

    def matrix_entries(self, weight: Float[Tensor, "P K"]) -> Float[Tensor, "P 4K"]:
        """Weights of directions as entries of a matrix on the sources."""
        return (weight[..., None] * self.bilinear.reshape(*weight.shape, 4)).reshape(self.columns.shape)


_PER_PIXEL = [field.name for field in fields(Lobes) if field.name != "sources"]


def trace_lobes(
    tracer: RayTracer,
    points: SurfacePoints,
    face_cells: NDArray[np.int64],
    cells: int,
    alpha: Float[Tensor, "#P 1"],
    samples: int,
    pyramid: Pyramid,
    offset: float,
    rotation: Float[Tensor, "N 3 3"] | None = None,
    seed: int = 0,
    metal: MetalSurface | None = None,
) -> Lobes:
    """Draws `samples` visible normals for each point, traces their reflections and looks them up in the light.

    A direction that hits the surface reads the radiance of the cache cell there (`face_cells`: the cell of each face),
    or is reflected by `metal`; then the sources have a block for each number of reflections.
    `rotation` (per view) rotates world directions into the light's own frame.
    """
    alpha = alpha.detach().expand(len(points), 1)
    frames, wo = DirectionFrames.of(points, offset), points.to_eye
    local_o = (frames.axes @ wo[..., None])[..., 0]
    n_wo = local_o[:, 2].clamp_min(MIN_EYE_COSINE)
    local_o = torch.nn.functional.normalize(torch.cat([local_o[:, :2], n_wo[:, None]], dim=1), dim=1)
    square = spiral_points(len(points), samples, seed, points.position.device)
    found = traced_lobes(tracer, frames, local_o, alpha, square, face_cells, pyramid, rotation, metal, seed)
    return Lobes(
        **found._asdict(),
        n_wo=n_wo,
        sampling_alpha=alpha,
        toward_eye=local_o,
        axes=frames.axes,
        sources=(pyramid.texels + cells) * (1 if metal is None else metal.blocks),
    )
