"""Specular radiance of a block of pixels: sparse, linear in light and ρs, and linearised in α between refreshes."""
# ruff: noqa: TID253

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from hir_plugins.reflectance_renderers.brdf import Model, directional_albedo_terms
from hir_plugins.reflectance_renderers.transport_ggx.linear_map import Pattern
from hir_plugins.reflectance_renderers.transport_ggx.lobes import Lobes

_ALPHA_STEP = 0.01
"""Relative step of the one-sided derivative in α; its error is far below that of the linearisation itself."""


class SpecularBlock:
    """The lobes of P pixels as matrices on the sources of light; `refresh` follows α."""

    def __init__(self, lobes: Lobes, model: Model) -> None:
        self._lobes = lobes
        self._pattern = Pattern(lobes.columns, lobes.sources)
        self._model = model
        self.alpha = torch.empty(0)

    def refresh(self, alpha: Float[Tensor, "#P 1"], rho_s: Float[Tensor, "#P C"]) -> None:
        """Rebuilds the matrices at width α (per pixel or one for all); the derivative in α is taken at `rho_s`."""
        lobes = self._lobes
        weight, grazing = lobes.weights(alpha)
        moved, moved_grazing = lobes.weights(alpha * (1 + _ALPHA_STEP))
        mean = rho_s.mean(dim=-1, keepdim=True)
        if self._model == "paper":
            slope = mean * (moved - weight)
        else:
            slope = mean * (moved - weight) + (1 - mean) * (moved_grazing - grazing)
        slope = slope / (alpha * _ALPHA_STEP)
        self.alpha = alpha
        self._w = lobes.spread(weight)
        self._g = lobes.spread(grazing)
        self._w_matrix = self._pattern.matrix(self._w)
        self._slope_matrix = self._pattern.matrix(lobes.spread(slope))
        self._w_transposed = self._pattern.transposed(self._w)
        if self._model == "dielectric":
            self._g_matrix = self._pattern.matrix(self._g)
            self._g_transposed = self._pattern.transposed(self._g)
            a, b = directional_albedo_terms(lobes.n_wo[:, None], alpha)
            self._albedo_terms = (a, b)

    def diffuse_share(self, rho_s: Float[Tensor, "#P C"]) -> Float[Tensor, "P C"] | float:
        """What the specular lobe leaves to the diffuse part: `1 − E` for `dielectric`, 1 for `paper`."""
        if self._model == "paper":
            return 1.0
        a, b = self._albedo_terms
        return (1 - rho_s * a - b).clamp_min(0)

    def radiance(
        self, sources: Float[Tensor, "S 3"], rho_s: Float[Tensor, "#P C"], alpha: Float[Tensor, "#P 1"]
    ) -> Float[Tensor, "P 3"]:
        """Specular radiance; differentiable in all three. α enters to first order around the last `refresh`."""
        count = len(self._lobes)
        return _Specular.apply(sources, rho_s.expand(count, -1), (alpha - self.alpha).expand(count, 1), self)


class _Specular(torch.autograd.Function):
    @staticmethod
    def forward(ctx, sources, rho_s, drift, block):  # type: ignore[no-untyped-def]
        w = block._w_matrix @ sources
        slope = block._slope_matrix @ sources
        if block._model == "paper":
            factor, value = w, rho_s * w
        else:
            g = block._g_matrix @ sources
            factor = w - g
            value = rho_s * factor + g
        ctx.block = block
        ctx.save_for_backward(rho_s, factor, slope)
        return value + drift * slope

    @staticmethod
    def backward(ctx, gradient):  # type: ignore[no-untyped-def]
        rho_s, factor, slope = ctx.saved_tensors
        block = ctx.block
        # the drift's own part of the light's gradient is left out: it vanishes at every refresh
        light = block._w_transposed @ (rho_s * gradient)
        if block._model == "dielectric":
            light = light + block._g_transposed @ ((1 - rho_s) * gradient)
        rho = gradient * factor
        rho = rho.sum(dim=1, keepdim=True) if rho_s.shape[1] == 1 else rho
        return light, rho, (gradient * slope).sum(dim=1, keepdim=True), None
