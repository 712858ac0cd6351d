"""Albedo at the resolution of the texture: pixels of all photographs see the bilinear texture, and the closed form
(`fit/closed_form_albedo.py`) solves it. The albedo at vertices is the prior. For `metallic` it is the base colour.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from hir_core.optimization.linear_maps import LinearMap
from hir_plugins.reflectance_renderers.transport_ggx.fit.closed_form_albedo import (
    AlbedoEquations,
    AlbedoRefiner,
    MetalTerm,
    solve_albedo,
)

MIN_PIXELS = 1.0
"""A texel counts as observed if more pixels than this see it."""
MIN_INFORMATION = 0.7
"""A texel counts as observed if the weight of its pixels exceeds this multiple of the prior's."""


@dataclass(frozen=True, eq=False)
class TexelEquations:
    """One row for each pixel: `gain · (texture at uv) + offset = color`.

    For `metallic` the texture is the base colour: `gain · ((1 − m)·base at uv) + metal_gain · (m·base at uv) + offset`.
    """

    index: Int[Tensor, "P 4"]
    """int32, as sparse matrices store it."""
    weight: Float[Tensor, "P 4"]
    gain: Float[Tensor, "P 3"]
    color: Float[Tensor, "P 3"]
    """Of the photograph, divided by its exposure."""
    offset: Float[Tensor, "P 3"]
    """Radiance that does not depend on the albedo: the specular lobe."""
    importance: Float[Tensor, "P 3"]
    clipped: Bool[Tensor, "P 3"]
    """Where the photograph is clipped: the left side may be larger."""
    pixel: Int[Tensor, "P 3"]
    """View, x and y; int32."""
    metal_gain: Float[Tensor, "P 3"] | None = None
    """Change of radiance with the base colour of a metal; only for `metallic`."""

    def radiance(
        self, texture: Float[Tensor, "H W 3"], metalness: Float[Tensor, "H W 1"] | None
    ) -> Float[Tensor, "P 3"]:
        """The left side without `offset`."""

        def at(texels: Tensor) -> Tensor:
            return (texels.reshape(-1, 3)[self.index] * self.weight[..., None]).sum(dim=1)

        if self.metal_gain is None or metalness is None:
            return self.gain * at(texture)
        return self.gain * at((1 - metalness) * texture) + self.metal_gain * at(metalness * texture)


def solve_texels(
    equations: list[TexelEquations],
    start: Float[Tensor, "H W 3"],
    huber_srgb: float,
    prior: float,
    smoothness: float = 0.0,
    metalness: Float[Tensor, "H W 1"] | None = None,
    refiner: AlbedoRefiner | None = None,
) -> tuple[Float[Tensor, "H W 3"], Bool[Tensor, "H W"]]:
    """Albedo in 0…1, or the base colour for a `metalness`, and the observed texels.

    `prior` and `smoothness` are the weights of `start` and of differences between neighbouring texels, as fractions of
    the mean weight of a texel's pixels.
    """
    height, width, _ = start.shape
    rows = _in_order_of_texels(equations, height * width, metalness)

    def differences(weight: Tensor) -> Callable[[Tensor, Tensor], None]:
        return _neighbour_differences(weight.reshape(height, width, 3))

    texture, count, information = solve_albedo(
        [rows], start.reshape(-1, 3), huber_srgb, prior, differences, smoothness, refiner
    )
    # a texel at the edge of a photograph or in the dark remains at its prior: it was not observed
    observed = (count > MIN_PIXELS) & (information > MIN_INFORMATION)
    return texture.reshape(height, width, 3), observed.reshape(height, width)


def _in_order_of_texels(
    equations: list[TexelEquations], texels: int, metalness: Float[Tensor, "H W 1"] | None
) -> AlbedoEquations:
    """All rows as one system. Rows that see the same texels lie together in memory: a solution takes 2.6 times less
    time than in the order of the photographs (docs/studies/closed_form_albedo.md).
    """
    index = torch.cat([e.index for e in equations])
    order = index[:, 0].argsort()

    def joined(parts: list[Tensor]) -> Tensor:
        return torch.cat(parts).index_select(0, order)  # three times faster than indexing

    metal = None
    if metalness is not None:
        gains = [e.metal_gain for e in equations if e.metal_gain is not None]
        assert len(gains) == len(equations), "equations of a metallic material have a metal gain"
        metal = MetalTerm(joined(gains), metalness.reshape(-1, 1))
    return AlbedoEquations(
        LinearMap.from_rows(index.index_select(0, order), joined([e.weight for e in equations]), texels),
        joined([e.gain for e in equations]),
        joined([e.color - e.offset for e in equations]),
        joined([e.importance for e in equations]),
        joined([e.clipped for e in equations]),
        metal,
    )


def _neighbour_differences(weight: Float[Tensor, "H W C"]) -> Callable[[Tensor, Tensor], None]:
    """A function of (x, image), both (HW, C), that adds the gradient of ½ Σ w_ij (x_i − x_j)² over neighbours.

    w_ij is the smaller of their weights.
    """
    pairs = []
    for dim in (0, 1):
        if (last := weight.shape[dim] - 1) > 0:
            pairs.append((dim, last, torch.minimum(weight.narrow(dim, 1, last), weight.narrow(dim, 0, last))))
    buffer = weight.new_empty(weight.numel())

    def add(x: Tensor, image: Tensor) -> None:
        values, total = x.view(weight.shape), image.view(weight.shape)
        for dim, last, smaller in pairs:
            step = buffer[: smaller.numel()].view(smaller.shape)
            torch.sub(values.narrow(dim, 1, last), values.narrow(dim, 0, last), out=step)
            step.mul_(smaller)
            total.narrow(dim, 1, last).add_(step)
            total.narrow(dim, 0, last).sub_(step)

    return add
