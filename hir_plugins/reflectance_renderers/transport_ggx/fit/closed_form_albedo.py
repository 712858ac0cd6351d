"""Albedo in closed form: for a given light and given lobes, pixels are linear in the diffuse albedo.

`I − S = (1 − E)·irradiance/π · ρd` is one row for each pixel, in the albedos of texels or of vertices. Conjugate
gradients solve all rows and all channels at once. Residuals have the weights of sRGB and of a robust loss (iteratively
re-weighted least squares). The initial albedo is the prior of what no pixel sees.

With the `metallic` BRDF the base colour is the unknown: it acts in the diffuse lobe with 1 − m and in the specular lobe
with m.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from hir_core.optimization.clipped_pixels import is_clipped_excess
from hir_core.optimization.linear_maps import LinearMap

AlbedoRefiner: TypeAlias = Callable[[Tensor, Tensor], Tensor]
"""(albedo in closed form (N, 3), curvature (N, 3) of the mean error of the pixels there) → refined albedo."""

NormalProduct: TypeAlias = Callable[[Tensor, Tensor], None]
"""(x, image), both (N, 3): adds the product of a symmetric matrix with x to `image`, in place."""

Differences: TypeAlias = Callable[[Tensor], NormalProduct]
"""Weights (N, 3) of the albedos → the function that adds the gradient of half the weighted squared differences of x."""

LEAST_LIGHT = 0.1
"""Share of the mean light, as squared gain: a third of the mean brightness. In less light the prior gains weight
against the pixels, because the errors of the light itself are large there (docs/studies/closed_form_albedo.md)."""

_REWEIGHTING_ITERATIONS = 3
_CONJUGATE_GRADIENT_ITERATIONS = 12
_ROWS_PER_BLOCK = 1 << 16


@dataclass(frozen=True, eq=False)
class MetalTerm:
    """The part of a base colour that acts in the specular lobe."""

    gain: Float[Tensor, "P 3"]
    """Change of radiance with the base colour of a metal."""
    metalness: Float[Tensor, "N 1"]
    """m at each albedo."""


@dataclass(frozen=True, eq=False)
class AlbedoEquations:
    """One row for each pixel: `gain · (lookup @ albedo) = target`.

    With `metal`: `gain · (lookup @ ((1 − m)·base)) + metal.gain · (lookup @ (m·base)) = target`.
    """

    lookup: LinearMap
    """(P, N): weight of each albedo in a pixel."""
    gain: Float[Tensor, "P 3"]
    """Radiance of a diffuse albedo of 1."""
    target: Float[Tensor, "P 3"]
    importance: Float[Tensor, "P 3"]
    clipped: Bool[Tensor, "P 3"]
    """Where the photograph is clipped: the left side may be larger than the target."""
    metal: MetalTerm | None = None

    def radiance(self, albedo: Float[Tensor, "N 3"]) -> Float[Tensor, "P 3"]:
        """The left side."""
        if self.metal is None:
            return self.gain * (self.lookup.matrix @ albedo)
        m = self.metal.metalness
        dielectric, metal = self.lookup.matrix @ ((1 - m) * albedo), self.lookup.matrix @ (m * albedo)
        return self.gain * dielectric + self.metal.gain * metal

    def transposed(self, weight: Float[Tensor, "P 3"], rows: Float[Tensor, "P 3"]) -> Float[Tensor, "N 3"]:
        """The transpose of the left side, applied to weighted rows."""
        if self.metal is None:
            return self.lookup.transposed @ (weight * self.gain * rows)
        m = self.metal.metalness
        diffuse, specular = weight * self.gain * rows, weight * self.metal.gain * rows
        return (1 - m) * (self.lookup.transposed @ diffuse) + m * (self.lookup.transposed @ specular)

    def normal_product(self, weight: Float[Tensor, "P 3"]) -> NormalProduct:
        """Of the normal matrix: the transpose of the left side times `weight` times the left side."""
        squares = weight * self.gain * self.gain

        def add(x: Tensor, image: Tensor) -> None:
            torch.addmm(image, self.lookup.transposed, (self.lookup.matrix @ x).mul_(squares), out=image)

        def add_with_metal(x: Tensor, image: Tensor) -> None:
            image.add_(self.transposed(weight, self.radiance(x)))

        return add if self.metal is None else add_with_metal

    def squared_gains(self, weight: Float[Tensor, "P 3"]) -> Float[Tensor, "N 3"]:
        """For each albedo: the weighted sum of the squared gains of its pixels."""
        squares = self.lookup.transposed @ (weight * self.gain * self.gain)
        if self.metal is None:
            return squares
        m, other = self.metal.metalness, self.metal.gain
        mixed, metal = (self.lookup.transposed @ (weight * gain * other) for gain in (self.gain, other))
        return ((1 - m).square() * squares + 2 * m * (1 - m) * mixed + m.square() * metal).clamp_min(0)


def solve_albedo(
    equations: Sequence[AlbedoEquations],
    start: Float[Tensor, "N 3"],
    huber_srgb: float,
    prior: float,
    differences: Differences | None = None,
    smoothness: float = 0.0,
    refiner: AlbedoRefiner | None = None,
) -> tuple[Float[Tensor, "N 3"], Float[Tensor, " N"], Float[Tensor, " N"]]:
    """Albedo in 0…1, the number of pixels that see each, and the weight of these pixels in units of the prior's.

    `prior` and `smoothness` are the weights of `start` and of `differences`. Both are fractions of the weight that the
    mean number of pixels has in the light and with the importance of an albedo's own pixels: the squared gain inside a
    vessel is a hundredth of the mean one, and black pixels weigh a thousand times as much as white ones. `refiner` gets
    the solution and the curvature there of the mean error over pixels and channels.
    """
    albedo = start.clone()
    count, prior_weight = _prior_scale(equations, start)
    add_differences = differences(smoothness * prior_weight) if differences is not None and smoothness > 0 else None
    prior_weight.mul_(prior)
    information = torch.zeros_like(count)
    preconditioner = torch.empty_like(start)
    for iteration in range(_REWEIGHTING_ITERATIONS):
        robust = [_robust_weight(rows, albedo, huber_srgb) for rows in equations]
        diagonal, right = preconditioner.zero_(), prior_weight * start
        for w, rows in zip(robust, equations, strict=True):
            diagonal += rows.squared_gains(w)
            right += rows.transposed(w, rows.target)

        products = [rows.normal_product(w) for w, rows in zip(robust, equations, strict=True)]
        if add_differences is not None:
            products.append(add_differences)

        def apply(x: Tensor, image: Tensor, products: list[NormalProduct] = products) -> None:
            torch.mul(prior_weight, x, out=image)
            for add_product in products:
                add_product(x, image)

        if iteration + 1 == _REWEIGHTING_ITERATIONS:
            information = (diagonal / prior_weight).mean(dim=1)
        diagonal.add_(prior_weight).reciprocal_()
        _conjugate_gradients(apply, right, albedo, preconditioner)
        albedo.clamp_(0, 1)
    if refiner is not None:
        channels = sum(rows.gain.numel() for rows in equations)
        albedo = refiner(albedo, preconditioner.reciprocal_() / channels)
    return albedo, count, information


def _prior_scale(
    equations: Sequence[AlbedoEquations], start: Float[Tensor, "N 3"]
) -> tuple[Float[Tensor, " N"], Float[Tensor, "N 3"]]:
    """The number of pixels that see each albedo, and the weight of the mean number of pixels in its light.

    Its light counts as at least `LEAST_LIGHT` and at most all of the mean light. With a metal it counts as the mean
    light: dark parts of a metal show reflections of reflections, whose errors are larger.
    """
    count, light, importance = (start.new_zeros(len(start), n) for n in (1, 3, 3))
    for rows in equations:
        count = count + rows.lookup.transposed @ torch.ones_like(rows.gain[:, :1])
        light = light + rows.squared_gains(torch.ones_like(rows.gain))
        importance = importance + rows.lookup.transposed @ rows.importance
    known = count[:, 0] > 0.5
    if not bool(known.any()):
        return count[:, 0], torch.ones_like(start)

    def of_a_pixel(total: Tensor) -> Tensor:
        mean = total[known].sum(0) / count[known].sum(0)
        return torch.where(known[:, None], total / count.clamp_min(0.5), mean)

    weight = light[known].mean(dim=0) * of_a_pixel(importance)
    if all(rows.metal is None for rows in equations):
        own_light = of_a_pixel(light) * count[known].sum() / light[known].sum(0).clamp_min(1e-12)
        weight = weight * own_light.clamp(LEAST_LIGHT, 1)
    return count[:, 0], weight.clamp_min(1e-12)


def _robust_weight(rows: AlbedoEquations, albedo: Tensor, huber_srgb: float) -> Float[Tensor, "P 3"]:
    difference = rows.radiance(albedo) - rows.target
    error = rows.importance.sqrt() * difference.abs()
    weight = rows.importance * (huber_srgb / error.clamp_min(huber_srgb))
    return torch.where(is_clipped_excess(difference, rows.clipped), 0.0, weight)


def _conjugate_gradients(
    apply: Callable[[Tensor, Tensor], None], residual: Tensor, x: Tensor, preconditioner: Tensor
) -> None:
    """Conjugate gradients with a Jacobi preconditioner; each column is a system of its own.

    `x` is the initial value and becomes the solution; `residual` is the right side and is overwritten.
    `apply(x, image)` writes the product with the matrix to `image`. All steps work in place: of a texture of 4096² each
    array has 200 MB, and its allocation takes longer than the arithmetic.
    """
    image = torch.empty_like(x)
    apply(x, image)
    residual.sub_(image)
    direction = preconditioner * residual
    rho = _column_sums(residual, direction)
    for _ in range(_CONJUGATE_GRADIENT_ITERATIONS):
        apply(direction, image)
        step = rho / _column_sums(direction, image).clamp_min(1e-30)
        x.addcmul_(direction, step)
        residual.addcmul_(image, step, value=-1)
        new = _column_sums(residual, residual, preconditioner)
        direction.mul_(new / rho.clamp_min(1e-30)).addcmul_(preconditioner, residual)
        rho = new


def _column_sums(first: Float[Tensor, "N C"], *others: Float[Tensor, "N C"]) -> Float[Tensor, " C"]:
    """Sums over the rows of the product of all arrays, block by block: no array of N rows is made."""
    total = first.new_zeros(first.shape[1])
    for start in range(0, len(first), _ROWS_PER_BLOCK):
        rows = slice(start, start + _ROWS_PER_BLOCK)
        product = first[rows] * others[0][rows]
        for other in others[1:]:
            product.mul_(other[rows])
        total += product.sum(dim=0)
    return total
