"""Albedo in closed form: once light and lobes are known, what pixels show is linear in it.

`I − S = (1 − E)·irradiance/π · ρd` is one row per pixel, in the albedos of texels or of vertices. Conjugate gradients
solve all of them and all channels at once; residuals are weighed as the eye (sRGB) and a robust loss weigh them
(iteratively re-weighted least squares), and what it starts from holds what no pixel sees.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from hir_plugins.reflectance_renderers.transport_ggx.operator.linear_maps import LinearMap

_ROUNDS = 3
_ITERATIONS = 12


@dataclass(frozen=True, eq=False)
class AlbedoEquations:
    """One row per pixel: `gain · (lookup @ albedo) = target`."""

    lookup: LinearMap
    """(P, N): how much of each albedo a pixel shows."""
    gain: Float[Tensor, "P 3"]
    target: Float[Tensor, "P 3"]
    importance: Float[Tensor, "P 3"]
    at_least: Bool[Tensor, "P 3"]
    """Where the photograph is clipped: the left side may be larger than the target."""


def solve_albedo(
    equations: Sequence[AlbedoEquations],
    start: Float[Tensor, "N 3"],
    huber: float,
    prior: float,
    differences: Callable[[Float[Tensor, "N 3"], Float[Tensor, "N 3"]], Float[Tensor, "N 3"]] | None = None,
    smooth: float = 0.0,
) -> tuple[Float[Tensor, "N 3"], Float[Tensor, " N"], Float[Tensor, " N"]]:
    """Albedo in 0…1, how many pixels look at each, and what they say in units of what `start` says.

    `prior` and `smooth` are the weights of the start and of `differences` (the gradient of half their squares, of given
    weights), as fractions of what the pixels of an albedo say on average: of as much light, each weighed as its own
    pixels are, for black pixels count for a thousand times what white ones do. `huber` is in sRGB.
    """
    albedo = start.clone()
    seen, hold = _hold(equations, start)
    told = torch.zeros_like(seen)
    for _ in range(_ROUNDS):
        robust = [_robust(rows, albedo, huber) for rows in equations]
        normal = [w * rows.gain * rows.gain for w, rows in zip(robust, equations, strict=True)]
        diagonal, right = torch.zeros_like(start), torch.zeros_like(start)
        for w, n, rows in zip(robust, normal, equations, strict=True):
            diagonal = diagonal + rows.lookup.transposed @ n
            right = right + rows.lookup.transposed @ (w * rows.gain * rows.target)

        def apply(x: Tensor, normal: list[Tensor] = normal) -> Tensor:
            image = prior * hold * x
            for n, rows in zip(normal, equations, strict=True):
                image = image + rows.lookup.transposed @ (n * (rows.lookup.matrix @ x))
            if differences is not None and smooth > 0:
                image = image + differences(x, smooth * hold)
            return image

        preconditioner = 1 / (diagonal + prior * hold)
        albedo = _conjugate_gradients(apply, right + prior * hold * start, albedo, preconditioner, _ITERATIONS)
        albedo = albedo.clamp(0, 1)
        told = (diagonal / (prior * hold)).mean(dim=1)
    return albedo, seen, told


def _hold(
    equations: Sequence[AlbedoEquations], start: Float[Tensor, "N 3"]
) -> tuple[Float[Tensor, " N"], Float[Tensor, "N 3"]]:
    """Pixels that look at each albedo, and what they would say of it under the light that all have on average."""
    seen, light, importance = (start.new_zeros(len(start), n) for n in (1, 3, 3))
    for rows in equations:
        seen = seen + rows.lookup.transposed @ torch.ones_like(rows.gain[:, :1])
        light = light + rows.lookup.transposed @ rows.gain.square()
        importance = importance + rows.lookup.transposed @ rows.importance
    known = seen[:, 0] > 0.5
    if not bool(known.any()):
        return seen[:, 0], torch.ones_like(start)
    each = torch.where(known[:, None], importance / seen.clamp_min(0.5), importance[known].sum(0) / seen[known].sum(0))
    return seen[:, 0], (light[known].mean(dim=0) * each).clamp_min(1e-12)


def _robust(rows: AlbedoEquations, albedo: Tensor, huber: float) -> Float[Tensor, "P 3"]:
    difference = rows.gain * (rows.lookup.matrix @ albedo) - rows.target
    error = rows.importance.sqrt() * difference.abs()
    satisfied = rows.at_least & (difference > 0)
    return torch.where(satisfied, 0.0, rows.importance * (huber / error.clamp_min(huber)))


def _conjugate_gradients(
    apply: Callable[[Tensor], Tensor], right: Tensor, start: Tensor, preconditioner: Tensor, iterations: int
) -> Tensor:
    """Jacobi-preconditioned conjugate gradients, each column a system of its own."""
    x = start
    residual = right - apply(x)
    z = preconditioner * residual
    direction = z
    rho = (residual * z).sum(0)
    for _ in range(iterations):
        image = apply(direction)
        step = rho / (direction * image).sum(0).clamp_min(1e-30)
        x = x + step * direction
        residual = residual - step * image
        z = preconditioner * residual
        new = (residual * z).sum(0)
        direction = z + (new / rho.clamp_min(1e-30)) * direction
        rho = new
    return x
