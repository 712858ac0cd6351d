"""Damped least squares of points with the `metallic` BRDF (Dr.Jit): the parameters are base colour and metalness.

The chain rule takes the normal equations of albedo and ρs (`brdf_fit_steps.py`) to base colour b and metalness m:
∂ρd/∂b = 1 − m, ∂ρs/∂b = m, ∂ρd/∂m = −b, ∂ρs/∂m = b − F0. The base colour is then eliminated colour by colour.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

from hir_plugins.reflectance_renderers.drjit_types import DrJitArray
from hir_plugins.reflectance_renderers.transport_ggx.textures.brdf_fit_state import (
    BrdfState,
    FitArrays,
    NormalEquations,
)
from hir_plugins.reflectance_renderers.transport_ggx.textures.brdf_fit_steps import (
    EPSILON,
    MAX_LEVEL_STEP,
    MAX_NORMAL_STEP,
    moved_lobe,
)

MAX_METALNESS_STEP = 0.5
"""Limit of one iteration's change."""


def metallic_step(
    fit: FitArrays, x: BrdfState, initial: BrdfState, current: NormalEquations, damping: DrJitArray
) -> BrdfState:
    """The next state of every point to try."""
    (dd, df, ff), (da, d1, d2, fa, f1, f2) = current.colors, current.mixed
    (aa, a1, a2, t11, t12, t22), (de, fe, ae, e1, e2) = current.shared, current.errors
    m, base = x.metalness, base_color(fit, x)
    rest, over = 1 - m, base - fit.dielectric_f0
    more = 1 + damping
    bb = (rest * rest * dd + 2 * rest * m * df + m * m * ff) * more + EPSILON
    bm = (rest * over - m * base) * df + m * over * ff - rest * base * dd
    ba, b1, b2, be = (rest * d + m * f for d, f in ((da, fa), (d1, f1), (d2, f2), (de, fe)))
    mm = _total(base * base * dd - 2 * base * over * df + over * over * ff) + fit.priors.metalness
    ma, m1, m2, me = (_total(over * f - base * d) for d, f in ((da, fa), (d1, f1), (d2, f2), (de, fe)))
    me += fit.priors.metalness * (m - initial.metalness)
    columns = (bm, ba, b1, b2)
    shared = [[mm, ma, m1, m2], [ma, aa, a1, a2], [m1, a1, t11, t12], [m2, a2, t12, t22]]
    errors = (me, ae, e1, e2)
    matrix = [
        [
            shared[i][j] * more + EPSILON - _total(columns[i] * columns[j] / bb)
            if i == j
            else shared[i][j] - _total(columns[i] * columns[j] / bb)
            for j in range(4)
        ]
        for i in range(4)
    ]
    right = [_total(columns[i] * be / bb) - errors[i] for i in range(4)]
    by_m, by_a, by_1, by_2 = solve_symmetric(matrix, right)
    limit = dr.clip(by_m, -MAX_METALNESS_STEP, MAX_METALNESS_STEP)
    metalness = dr.clip(m + limit, 0, 1)
    by_a = dr.clip(by_a, -MAX_LEVEL_STEP, MAX_LEVEL_STEP)
    by_1, by_2 = (dr.clip(by, -MAX_NORMAL_STEP, MAX_NORMAL_STEP) for by in (by_1, by_2))
    left = be + bm * (metalness - m) + ba * by_a + b1 * by_1 + b2 * by_2
    albedo, specular = effective_albedos(fit, dr.clip(base - left / bb, 0, 1), metalness)
    return moved_lobe(x, albedo, specular, by_a, by_1, by_2, metalness)


def base_color(fit: FitArrays, x: BrdfState) -> DrJitArray:
    """The base colour of a state."""
    return x.albedo + x.specular - (1 - x.metalness) * fit.dielectric_f0


def effective_albedos(fit: FitArrays, base: DrJitArray, metalness: DrJitArray) -> tuple[DrJitArray, DrJitArray]:
    """ρd and ρs of a base colour."""
    rest = 1 - metalness
    return rest * base, mi.Vector3f(rest * fit.dielectric_f0) + metalness * base


def solve_symmetric(matrix: Sequence[Sequence[DrJitArray]], right: Sequence[DrJitArray]) -> list[DrJitArray]:
    """The solution of a symmetric positive definite system, by LDLᵀ after scaling its diagonal to 1; a direction
    without information does not move.
    """
    size = len(right)
    scale = [dr.rsqrt(dr.maximum(matrix[i][i], EPSILON)) for i in range(size)]
    lower: list[list[DrJitArray]] = [[] for _ in range(size)]
    pivots: list[DrJitArray] = []
    solution: list[DrJitArray] = []
    for i in range(size):
        for j in range(i):
            value = matrix[i][j] * scale[i] * scale[j]
            for k in range(j):
                value = value - lower[i][k] * lower[j][k] * pivots[k]
            lower[i].append(value / pivots[j])
        pivot, value = matrix[i][i] * scale[i] * scale[i] + 1e-6, right[i] * scale[i]
        for k in range(i):
            pivot = pivot - lower[i][k] * lower[i][k] * pivots[k]
            value = value - lower[i][k] * solution[k]
        pivots.append(dr.maximum(pivot, 1e-6))
        solution.append(value)
    solution = [value / pivot for value, pivot in zip(solution, pivots, strict=True)]
    for i in reversed(range(size)):
        for k in range(i + 1, size):
            solution[i] = solution[i] - lower[k][i] * solution[k]
    return [value * s for value, s in zip(solution, scale, strict=True)]


def _total(colors: DrJitArray) -> DrJitArray:
    return colors.x + colors.y + colors.z
