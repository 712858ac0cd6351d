"""Specular radiance of a pixel batch: sparse, linear in the light, linearised in ρs, normals and α between refreshes.

One matrix holds the whole lobe, with Fresnel's term of a pixel's mean ρs at the last refresh. For another ρs, and for
each colour channel, a pixel's radiance changes by the ratio of both reflectances of a white light. That is exact for a
white light and for the ρs of the refresh, and takes half of the time of one matrix for each end of Schlick's term
(docs/studies/directions_of_lobes.md).

The derivative in α comes from outside, from lobes of other widths: that of the weights of fixed directions is mostly
noise (docs/studies/lobe_width.md).
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.optimization.linear_maps import SparsityPattern
from hir_plugins.reflectance_renderers.brdf_torch import Model, directional_albedo_terms
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.specular_lobes import Lobes

_NORMAL_STEP_IN_ALPHAS = 0.02
"""Finite-difference step of the normal, as a fraction of α."""


class SpecularMatrices:
    """The lobes of P pixels as matrices on the light sources; `refresh` rebuilds them for a new α."""

    def __init__(self, lobes: Lobes, model: Model) -> None:
        self._lobes = lobes
        self._pattern = SparsityPattern(lobes.columns, lobes.sources)
        self._model = model
        self.alpha = torch.empty(0)
        self.normal: Tensor | None = None
        self.alpha_slope: Tensor | None = None
        """Derivative of the radiance in α (P, 3), set after a `refresh` where α changes until the next one."""

    def refresh(
        self, alpha: Float[Tensor, "#P 1"], rho_s: Float[Tensor, "#P C"], normal: Float[Tensor, "P 3"] | None = None
    ) -> None:
        """Rebuilds the matrices for α (per pixel or one for all) and for shading normals, if there are any, in the axes
        of the lobes. Derivatives are taken at `rho_s`.
        """
        lobes = self._lobes
        weight, grazing = lobes.weights(alpha, normal)
        mean = rho_s.mean(dim=-1, keepdim=True)

        def slope(moved: Tensor, moved_grazing: Tensor) -> Tensor:
            if self._model == "paper":
                return mean * (moved - weight)
            return mean * (moved - weight) + (1 - mean) * (moved_grazing - grazing)

        slopes = []
        if normal is not None:
            for axis in range(2):
                step = torch.zeros_like(normal)
                step[:, axis] = (_NORMAL_STEP_IN_ALPHAS * alpha).expand(len(normal), 1)[:, 0]
                turned = torch.nn.functional.normalize(normal + step, dim=1, eps=1e-12)
                slopes.append(slope(*lobes.weights(alpha, turned)) / (_NORMAL_STEP_IN_ALPHAS * alpha))
        self.alpha, self.normal, self.alpha_slope = alpha, normal, None
        self._slopes = [self._pattern.matrix(lobes.matrix_entries(values)) for values in slopes]
        self._transposed: Tensor | None = None
        if self._model == "paper":
            self._entries = lobes.matrix_entries(weight)
        else:
            self._entries = lobes.matrix_entries(mean * (weight - grazing) + grazing)
            total = weight.sum(dim=1, keepdim=True)
            self._grazing = (grazing.sum(dim=1, keepdim=True) / total.clamp_min(1e-9)).clamp(0, 1)
            self._fresnel = (mean + (1 - mean) * self._grazing).clamp_min(1e-9)
            a, b = directional_albedo_terms(lobes.cosine_of_eye(normal)[:, None], alpha)
            self._albedo_terms = (a, b)
        self._matrix = self._pattern.matrix(self._entries)

    @property
    def model(self) -> Model:
        """The BRDF whose lobes these are."""
        return self._model

    def scale(self, rho_s: Float[Tensor, "P C"]) -> Float[Tensor, "P C"]:
        """Factor of the matrix's radiance for ρs."""
        if self._model == "paper":
            return rho_s
        return (rho_s + (1 - rho_s) * self._grazing) / self._fresnel

    def scale_slope(self) -> Float[Tensor, "P 1"] | float:
        """Derivative of `scale` in ρs."""
        return 1.0 if self._model == "paper" else (1 - self._grazing) / self._fresnel

    def light_gradient(self, gradient: Float[Tensor, "P 3"], rho_s: Float[Tensor, "P C"]) -> Float[Tensor, "S 3"]:
        """Gradient of the light sources. The transpose is made at the first one after a `refresh`."""
        if self._transposed is None:
            self._transposed = self._pattern.transposed(self._entries)
        return self._transposed @ (self.scale(rho_s) * gradient)

    def diffuse_share(self, rho_s: Float[Tensor, "#P C"]) -> Float[Tensor, "P C"] | float:
        """Factor of the diffuse part: `1 − E` for `dielectric`, 1 for `paper`."""
        if self._model == "paper":
            return 1.0
        a, b = self._albedo_terms
        return (1 - rho_s * a - b).clamp_min(0)

    def share_change(self) -> Float[Tensor, "P 1"]:
        """How much `diffuse_share` of `dielectric` falls with ρs."""
        return self._albedo_terms[0]

    def albedo_gain(self, sources: Float[Tensor, "S 3"]) -> Float[Tensor, "P 3"]:
        """Change of the specular radiance with ρs, for the α and the normals of the last `refresh`."""
        return self.scale_slope() * (self._matrix @ sources)

    def radiance(
        self,
        sources: Float[Tensor, "S 3"],
        rho_s: Float[Tensor, "#P C"],
        alpha: Float[Tensor, "#P 1"],
        normal: Float[Tensor, "P 3"] | None = None,
    ) -> Float[Tensor, "P 3"]:
        """Specular radiance; differentiable in light, ρs and normals, and in α where `alpha_slope` is set.

        α and normals enter to first order around the last `refresh`.
        """
        count = len(self._lobes)
        drift = sources.new_zeros(count, 0)
        if normal is not None and self.normal is not None:
            drift = (normal - self.normal)[:, :2]
        value: Tensor = _Specular.apply(sources, rho_s.expand(count, -1), drift, self)
        return value if self.alpha_slope is None else value + (alpha - self.alpha) * self.alpha_slope


class _Specular(torch.autograd.Function):
    @staticmethod
    def forward(ctx, sources, rho_s, drift, block):  # type: ignore[no-untyped-def]
        lobe = block._matrix @ sources
        slopes = [matrix @ sources for matrix in block._slopes[: drift.shape[1]]]
        value, factor = block.scale(rho_s) * lobe, block.scale_slope() * lobe
        ctx.block = block
        ctx.save_for_backward(rho_s, factor, *slopes)
        for i, slope in enumerate(slopes):
            value = value + drift[:, i : i + 1] * slope
        return value

    @staticmethod
    def backward(ctx, gradient):  # type: ignore[no-untyped-def]
        rho_s, factor, *slopes = ctx.saved_tensors
        block = ctx.block
        # the light's gradient leaves out the first-order terms: they vanish at every refresh
        light = block.light_gradient(gradient, rho_s)
        rho = gradient * factor
        rho = rho.sum(dim=1, keepdim=True) if rho_s.shape[1] == 1 else rho
        drift = [(gradient * slope).sum(dim=1, keepdim=True) for slope in slopes]
        return light, rho, torch.cat(drift, dim=1) if drift else None, None
