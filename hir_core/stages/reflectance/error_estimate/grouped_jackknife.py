"""Standard errors of linear least squares by a delete-a-group jackknife: local parameters, and some that all share.

The photographs are divided into groups. The spread of the estimates that each leave one group out is the standard error
of the whole estimate (Kott 2001, "The delete-a-group jackknife"). Errors that the pixels of one photograph have in
common are in it; a formula for independent pixels would count each of them as evidence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

Array = NDArray[np.float64]

MIN_EFFECTIVE_GROUPS = 1.5
"""Groups that a parameter's evidence comes from, below which its spread over groups says nothing."""


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """`hessian · change = −gradient` of B blocks with n parameters, for each of G groups."""

    hessian: Float[Array, "G B n n"]
    """Sums over pixels of the products of derivatives, weighted."""
    gradient: Float[Array, "G B n"]
    """Sums over pixels of derivative times residual, weighted."""


@dataclass(frozen=True, eq=False)
class StandardErrors:
    """Of the local parameters of each block, and of the shared ones; never above the width of the prior."""

    local: Float[Array, "B L"]
    shared: Float[Array, " S"]


def standard_errors(
    equations: NormalEquations, shared: tuple[int, ...], prior_width: Float[Array, " n"], noise: float
) -> StandardErrors:
    """Root mean squared errors of the estimate from all groups.

    `shared` are the indices of parameters that all blocks have in common, the others are local. `prior_width` is the
    standard deviation of each parameter where nothing is known, `noise` the standard deviation of a residual. Where the
    equations do not determine a parameter, its error is that of the prior.
    """
    groups, _, count = equations.gradient.shape
    local = tuple(each for each in range(count) if each not in shared)
    precision = noise**2 / prior_width**2
    whole = equations.hessian.sum(axis=0), equations.gradient.sum(axis=0)
    best = _solution(*whole, local, shared, precision)
    others = [
        _solution(whole[0] - equations.hessian[group], whole[1] - equations.gradient[group], local, shared, precision)
        for group in range(groups)
    ]
    evidence = np.einsum("gbii->gbi", equations.hessian)
    bias = _prior_bias(whole[0], local, shared, precision, prior_width)
    found = []
    for part, (indices, at) in enumerate(((local, evidence), (shared, evidence.sum(axis=1, keepdims=True)))):
        changes = np.stack([other[part] for other in others]) - best[part]
        variance = (groups - 1) / groups * ((changes - changes.mean(axis=0)) ** 2).sum(axis=0)
        at = at[..., list(indices)]
        effective = at.sum(axis=0) ** 2 / np.maximum((at**2).sum(axis=0), np.finfo(np.float64).tiny)
        few = effective < MIN_EFFECTIVE_GROUPS
        # few groups: their spread is an underestimate by n / (n − 1)
        variance = variance * np.where(few, 1.0, effective / np.maximum(effective - 1, 1e-6)).reshape(variance.shape)
        width = prior_width[list(indices)]
        error = np.minimum(np.sqrt(variance + bias[part] ** 2), width)
        found.append(np.where(few.reshape(variance.shape), width, error))
    return StandardErrors(found[0], found[1])


def _solution(
    hessian: Array, gradient: Array, local: tuple[int, ...], shared: tuple[int, ...], precision: Array
) -> tuple[Array, Array]:
    """Changes of the local (B, L) and the shared parameters (S,): block elimination of the local ones."""
    own, both, common = _parts(hessian, local, shared, precision)
    own_gradient, common_gradient = gradient[:, local], gradient[:, shared].sum(axis=0)
    if not shared:
        return np.asarray(-np.linalg.solve(own, own_gradient[..., None])[..., 0]), np.zeros(0)
    solved = np.linalg.solve(own, np.concatenate([both, own_gradient[..., None]], axis=2))
    by_shared, alone = solved[..., :-1], solved[..., -1]
    schur = common - np.einsum("bls,blt->st", both, by_shared)
    right = common_gradient - np.einsum("bls,bl->s", both, alone)
    change = -np.linalg.solve(schur, right)
    return np.asarray(-alone - by_shared @ change), change


def _prior_bias(
    hessian: Array, local: tuple[int, ...], shared: tuple[int, ...], precision: Array, width: Array
) -> tuple[Array, Array]:
    """How far the prior holds an estimate back from the truth, as a standard deviation."""
    own, both, common = _parts(hessian, local, shared, precision)
    pull = np.linalg.solve(own, np.broadcast_to(np.diag(precision[list(local)]), own.shape))
    of_local = np.sqrt((pull**2 * width[list(local)] ** 2).sum(axis=2))
    if not shared:
        return of_local, np.zeros(0)
    schur = common - np.einsum("bls,blt->st", both, np.linalg.solve(own, both))
    pull = np.linalg.solve(schur, np.diag(precision[list(shared)]))
    return of_local, np.sqrt((pull**2 * width[list(shared)] ** 2).sum(axis=1))


def _parts(
    hessian: Array, local: tuple[int, ...], shared: tuple[int, ...], precision: Array
) -> tuple[Array, Array, Array]:
    """Local (B, L, L), mixed (B, L, S) and shared (S, S) parts, with the prior."""
    own = hessian[:, local][:, :, local] + np.diag(precision[list(local)])
    both = hessian[:, local][:, :, shared]
    common = hessian[:, shared][:, :, shared].sum(axis=0) + np.diag(precision[list(shared)])
    return own, both, common
