"""Damped least squares of many points at once, one in each lane (Dr.Jit): normal equations and the next step.

Levenberg–Marquardt steps on robust residuals in sRGB. The colours of albedo and ρs are coupled only through α and the
normal, so the 9×9 system of a point reduces to three of 2×2 and one of 3×3.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

from hir_plugins.reflectance_renderers.drjit_clipped_pixels import without_clipped_excess
from hir_plugins.reflectance_renderers.drjit_srgb import linear_to_srgb_and_slope
from hir_plugins.reflectance_renderers.drjit_types import DrJitArray
from hir_plugins.reflectance_renderers.transport_ggx.operator.probe_lookup import (
    Lobe,
    Patch,
    lobe_of,
    patch_around,
    patch_radiance,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.radiance_probes import ALPHA_LEVELS
from hir_plugins.reflectance_renderers.transport_ggx.operator.shading_normals import MAX_NORMAL_OFFSET
from hir_plugins.reflectance_renderers.transport_ggx.textures.brdf_fit_state import (
    MIN_SPECULAR_ALBEDO,
    BrdfState,
    FitArrays,
    NormalEquations,
    mean_of,
)

LEVEL_DIFFERENCE, NORMAL_DIFFERENCE = 0.2, 0.03
"""Steps of the one-sided differences in the level of α and in the normal offset. They use the probe texels of the
value: own texels gain nothing (chair, 12 steps, held out: 22.619 dB instead of 22.616)."""
MAX_LEVEL_STEP, MAX_NORMAL_STEP = 1.5, 0.4
"""Limits of one iteration's change."""
EPSILON = 1e-9


def normal_equations(takes: Sequence[FitArrays], x: BrdfState, initial: BrdfState) -> NormalEquations:
    """The normal equations of all photographs of each point at a state, and of the prior towards `initial`."""
    total = _of_photographs(takes[0], x)
    for fit in takes[1:]:
        total = _sum(total, _of_photographs(fit, x))
    return _with_prior(takes[0], total, x, initial)


@dr.syntax
def _of_photographs(fit: FitArrays, x: BrdfState) -> NormalEquations:
    """The normal equations of the photographs of one take."""
    normal = shading_normal(fit, x.along, x.across)
    normal_1 = shading_normal(fit, x.along + NORMAL_DIFFERENCE, x.across)
    normal_2 = shading_normal(fit, x.along, x.across + NORMAL_DIFFERENCE)
    arriving, arriving_1, arriving_2 = (
        arriving_radiance(fit, normal),
        arriving_radiance(fit, normal_1),
        arriving_radiance(fit, normal_2),
    )
    wider = dr.select(x.level > ALPHA_LEVELS - 1.5, -LEVEL_DIFFERENCE, LEVEL_DIFFERENCE)
    mean = mean_of(x.specular)
    lane, view, cost = dr.arange(mi.UInt32, fit.count), mi.UInt32(0), dr.zeros(mi.Float, fit.count)
    huber = fit.priors.huber_srgb
    dd, df, ff, de, fe = (mi.Vector3f(0) for _ in range(5))
    da, d1, d2, fa, f1, f2 = (mi.Vector3f(0) for _ in range(6))
    aa, a1, a2, t11, t12, t22 = (mi.Float(0) for _ in range(6))
    ae, e1, e2 = (mi.Float(0) for _ in range(3))
    while view < fit.views:
        row = view * fit.points + lane
        weight = dr.gather(mi.Float, fit.weight, row)
        if weight > 0:
            eye = dr.normalize(dr.gather(mi.Vector3f, fit.eyes, view) - fit.position)
            lobe = lobe_of(normal, eye, x.level, mean, fit.coupled)
            patch = patch_around(fit.probes, fit.first, lobe)
            light = patch_radiance(patch, lobe)
            left = dr.maximum(1 - fit.coupled * (x.specular * lobe.scale + lobe.bias), 0)
            value = x.albedo * left * arriving + light * (x.specular * lobe.scale + lobe.bias)
            shown, steep = linear_to_srgb_and_slope(value)
            color = dr.gather(mi.Vector3f, fit.color, row)
            off = shown - color
            clipped = color >= dr.gather(mi.Vector3f, fit.ceiling, view)
            off = without_clipped_excess(off, clipped)
            size = dr.abs(off)
            part = dr.select(size < huber, 0.5 * off * off, huber * (size - 0.5 * huber))
            cost += weight * (part.x + part.y + part.z)
            trust = dr.select(off == 0, 0, weight * dr.minimum(1, huber / dr.maximum(size, EPSILON)))
            to_d = steep * left * arriving
            to_f = steep * lobe.scale * (light - fit.coupled * x.albedo * arriving)
            rougher = lobe_of(normal, eye, x.level + wider, mean, fit.coupled)
            to_a = steep * (radiance(fit, x, patch, rougher, arriving) - value) / wider
            turned = lobe_of(normal_1, eye, x.level, mean, fit.coupled)
            to_1 = steep * (radiance(fit, x, patch, turned, arriving_1) - value) / NORMAL_DIFFERENCE
            turned = lobe_of(normal_2, eye, x.level, mean, fit.coupled)
            to_2 = steep * (radiance(fit, x, patch, turned, arriving_2) - value) / NORMAL_DIFFERENCE
            dd += trust * to_d * to_d
            df += trust * to_d * to_f
            ff += trust * to_f * to_f
            de += trust * to_d * off
            fe += trust * to_f * off
            da += trust * to_d * to_a
            d1 += trust * to_d * to_1
            d2 += trust * to_d * to_2
            fa += trust * to_f * to_a
            f1 += trust * to_f * to_1
            f2 += trust * to_f * to_2
            aa += dr.dot(trust * to_a, to_a)
            a1 += dr.dot(trust * to_a, to_1)
            a2 += dr.dot(trust * to_a, to_2)
            t11 += dr.dot(trust * to_1, to_1)
            t12 += dr.dot(trust * to_1, to_2)
            t22 += dr.dot(trust * to_2, to_2)
            ae += dr.dot(trust * to_a, off)
            e1 += dr.dot(trust * to_1, off)
            e2 += dr.dot(trust * to_2, off)
        view += 1
    return NormalEquations(
        cost, (dd, df, ff), (da, d1, d2, fa, f1, f2), (aa, a1, a2, t11, t12, t22), (de, fe, ae, e1, e2)
    )


def _sum(one: NormalEquations, other: NormalEquations) -> NormalEquations:
    def added(a: tuple[DrJitArray, ...], b: tuple[DrJitArray, ...]) -> tuple[DrJitArray, ...]:
        return tuple(x + y for x, y in zip(a, b, strict=True))

    return NormalEquations(
        one.cost + other.cost,
        added(one.colors, other.colors),
        added(one.mixed, other.mixed),
        added(one.shared, other.shared),
        added(one.errors, other.errors),
    )


def _with_prior(fit: FitArrays, total: NormalEquations, x: BrdfState, initial: BrdfState) -> NormalEquations:
    (dd, df, ff), (aa, a1, a2, t11, t12, t22), (de, fe, ae, e1, e2) = total.colors, total.shared, total.errors
    prior = fit.priors
    albedo, specular, level = x.albedo - initial.albedo, x.specular - initial.specular, x.level - initial.level
    along, across = x.along - initial.along, x.across - initial.across
    penalty = prior.albedo * dr.squared_norm(albedo) + prior.specular * dr.squared_norm(specular)
    penalty += prior.level * level * level + prior.normal_offset * (along * along + across * across)
    if fit.metallic:
        penalty += prior.metalness * dr.square(x.metalness - initial.metalness)
    return NormalEquations(
        total.cost + 0.5 * penalty,
        (dd + prior.albedo, df, ff + prior.specular),
        total.mixed,
        (aa + prior.level, a1, a2, t11 + prior.normal_offset, t12, t22 + prior.normal_offset),
        (
            de + prior.albedo * albedo,
            fe + prior.specular * specular,
            ae + prior.level * level,
            e1 + prior.normal_offset * along,
            e2 + prior.normal_offset * across,
        ),
    )


def step(fit: FitArrays, x: BrdfState, current: NormalEquations, damping: DrJitArray) -> BrdfState:
    """The next state of every point to try: albedo and ρs are eliminated channel by channel."""
    (dd, df, ff), (da, d1, d2, fa, f1, f2) = current.colors, current.mixed
    (aa, a1, a2, t11, t12, t22), (de, fe, ae, e1, e2) = current.shared, current.errors
    more = 1 + damping
    dd, ff, aa = dd * more + EPSILON, ff * more + EPSILON, aa * more + EPSILON
    t11, t22 = t11 * more + EPSILON, t22 * more + EPSILON
    whole = dr.rcp(dr.maximum(dd * ff - df * df, 1e-20))
    i_dd, i_df, i_ff = ff * whole, -df * whole, dd * whole

    def without(p: tuple[DrJitArray, DrJitArray], q: tuple[DrJitArray, DrJitArray]) -> DrJitArray:
        """pᵀ (2×2)⁻¹ q, summed over channels."""
        total = p[0] * (i_dd * q[0] + i_df * q[1]) + p[1] * (i_df * q[0] + i_ff * q[1])
        return total.x + total.y + total.z

    column_a, column_1, column_2, column_e = (da, fa), (d1, f1), (d2, f2), (de, fe)
    aa, a1, a2 = aa - without(column_a, column_a), a1 - without(column_a, column_1), a2 - without(column_a, column_2)
    t11, t12, t22 = (
        t11 - without(column_1, column_1),
        t12 - without(column_1, column_2),
        t22 - without(column_2, column_2),
    )
    right = -mi.Vector3f(
        ae - without(column_a, column_e), e1 - without(column_1, column_e), e2 - without(column_2, column_e)
    )
    # Cramer's rule on the matrix scaled to a diagonal of 1
    s_a, s_1, s_2 = (dr.rsqrt(dr.maximum(v, EPSILON)) for v in (aa, t11, t22))
    c_a = mi.Vector3f(aa * s_a * s_a + 1e-6, a1 * s_a * s_1, a2 * s_a * s_2)
    c_1 = mi.Vector3f(a1 * s_a * s_1, t11 * s_1 * s_1 + 1e-6, t12 * s_1 * s_2)
    c_2 = mi.Vector3f(a2 * s_a * s_2, t12 * s_1 * s_2, t22 * s_2 * s_2 + 1e-6)
    volume = dr.dot(c_a, dr.cross(c_1, c_2))
    inverse = dr.select(volume > 1e-12, dr.rcp(dr.maximum(volume, 1e-12)), 0)
    right = right * mi.Vector3f(s_a, s_1, s_2)
    by_a = dr.clip(s_a * inverse * dr.dot(right, dr.cross(c_1, c_2)), -MAX_LEVEL_STEP, MAX_LEVEL_STEP)
    by_1 = dr.clip(s_1 * inverse * dr.dot(right, dr.cross(c_2, c_a)), -MAX_NORMAL_STEP, MAX_NORMAL_STEP)
    by_2 = dr.clip(s_2 * inverse * dr.dot(right, dr.cross(c_a, c_1)), -MAX_NORMAL_STEP, MAX_NORMAL_STEP)
    rest_d, rest_f = -de - da * by_a - d1 * by_1 - d2 * by_2, -fe - fa * by_a - f1 * by_1 - f2 * by_2
    albedo = dr.clip(x.albedo + i_dd * rest_d + i_df * rest_f, 0, 1)
    specular = dr.clip(x.specular + i_df * rest_d + i_ff * rest_f, MIN_SPECULAR_ALBEDO, 1)
    # in `paper` albedo and ρs together are at most 1; in `dielectric` the lobe reduces the diffuse part
    specular = specular if fit.coupled else dr.minimum(specular, dr.maximum(1 - albedo, MIN_SPECULAR_ALBEDO))
    return moved_lobe(x, albedo, specular, by_a, by_1, by_2, x.metalness)


def moved_lobe(
    x: BrdfState,
    albedo: DrJitArray,
    specular: DrJitArray,
    by_a: DrJitArray,
    by_1: DrJitArray,
    by_2: DrJitArray,
    metalness: DrJitArray,
) -> BrdfState:
    """The state with new albedos and metalness, and with level and normal offset moved within their limits."""
    along, across = x.along + by_1, x.across + by_2
    short = _shortened(along, across)
    level = dr.clip(x.level + by_a, 0, ALPHA_LEVELS - 1)
    return BrdfState(albedo, specular, level, along * short, across * short, metalness)


def radiance(fit: FitArrays, x: BrdfState, patch: Patch, lobe: Lobe, arriving: DrJitArray) -> DrJitArray:
    """Radiance of the points of a state for a lobe."""
    reflected = x.specular * lobe.scale + lobe.bias
    return x.albedo * dr.maximum(1 - fit.coupled * reflected, 0) * arriving + patch_radiance(patch, lobe) * reflected


def shading_normal(fit: FitArrays, along: DrJitArray, across: DrJitArray) -> DrJitArray:
    """`shading_normals.offset_normals` in the tangent frame of each point."""
    short = _shortened(along, across)
    return dr.normalize(fit.normal + short * (along * fit.tangent + across * fit.bitangent))


def arriving_radiance(fit: FitArrays, normal: DrJitArray) -> DrJitArray:
    """`shading_normals.shading_normal_irradiance`, over π."""
    cosine = dr.dot(fit.normal, normal)
    off = normal - cosine * fit.normal
    change = mi.Vector3f(*(dr.dot(off, vector) for vector in fit.vectors))
    return dr.maximum((1 + cosine) / 2 * fit.irradiance + change, 0) / dr.pi


def _shortened(along: DrJitArray, across: DrJitArray) -> DrJitArray:
    return dr.minimum(1, MAX_NORMAL_OFFSET * dr.rsqrt(dr.maximum(along * along + across * across, 1e-20)))
