"""Damped least squares of many points at once, one to a lane (Dr.Jit): what their photographs say, and the next step.

Levenberg's and Marquardt's steps on robust differences in sRGB. Albedo and ρs of a channel meet only in α and the
normal, so that the 9×9 system of a point falls into three of 2×2 and one of 3×3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi

from hir_plugins.reflectance_renderers.transport_ggx.fit.shading_normals import STEEPEST
from hir_plugins.reflectance_renderers.transport_ggx.operator.probe_lookup import (
    Lobe,
    Patch,
    gathered,
    lobe_of,
    patch_around,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.radiance_probes import LEVELS

if TYPE_CHECKING:
    from hir_plugins.reflectance_renderers.transport_ggx.textures.brdf_fit import PointFit

LEVEL_STEP, TILT_STEP = 0.2, 0.03
"""Of the derivatives in the level of α and in the normal: one-sided differences, on the patch of the value itself.
With patches of their own points end no better (chair, 12 steps, held out: 22.619 dB instead of 22.616)."""
LONGEST_LEVEL, LONGEST_TILT = 1.5, 0.4
"""Of one step."""
LEAST_RHO = 0.002
ROUND = 1e-9


@dataclass
class State:
    """Unknowns of all points; a tree that Dr.Jit can carry."""

    albedo: Any
    specular: Any
    level: Any
    along: Any
    across: Any


@dataclass
class Equations:
    """The cost of a state and its normal equations. d is an albedo, f a ρs, by colour; a is the level of α, 1 and 2 the
    tilt; e what they are to mend.
    """

    cost: Any
    """Robust squares of all photographs of each point, and of the distance to its start."""
    colors: Any
    """dd, df, ff."""
    mixed: Any
    """da, d1, d2, fa, f1, f2."""
    shared: Any
    """aa, a1, a2, t11, t12, t22."""
    errors: Any
    """de, fe, by colour, and ae, e1, e2."""


@dr.syntax
def equations(fit: PointFit, x: State, start: State) -> Equations:
    """What every point's photographs say of a state, and how `start` holds it."""
    normal = bent_normal(fit, x.along, x.across)
    normal_1 = bent_normal(fit, x.along + TILT_STEP, x.across)
    normal_2 = bent_normal(fit, x.along, x.across + TILT_STEP)
    arriving, arriving_1, arriving_2 = arriving_at(fit, normal), arriving_at(fit, normal_1), arriving_at(fit, normal_2)
    wider = dr.select(x.level > LEVELS - 1.5, -LEVEL_STEP, LEVEL_STEP)
    lane, view, cost = dr.arange(mi.UInt32, fit.count), mi.UInt32(0), dr.zeros(mi.Float, fit.count)
    huber = fit.holds.huber
    dd, df, ff, de, fe = (mi.Vector3f(0) for _ in range(5))
    da, d1, d2, fa, f1, f2 = (mi.Vector3f(0) for _ in range(6))
    aa, a1, a2, t11, t12, t22 = (mi.Float(0) for _ in range(6))
    ae, e1, e2 = (mi.Float(0) for _ in range(3))
    while view < fit.views:
        row = view * fit.points + lane
        weight = dr.gather(mi.Float, fit.weight, row)
        if weight > 0:
            eye = dr.normalize(dr.gather(mi.Vector3f, fit.eyes, view) - fit.place)
            lobe = lobe_of(normal, eye, x.level, fit.coupled)
            patch = patch_around(fit.probes, fit.first, lobe)
            light = gathered(patch, lobe)
            left = dr.maximum(1 - fit.coupled * (x.specular * lobe.scale + lobe.bias), 0)
            value = x.albedo * left * arriving + light * (x.specular * lobe.scale + lobe.bias)
            shown, steep = _srgb_and_slope(value)
            color = dr.gather(mi.Vector3f, fit.color, row)
            off = shown - color
            # a clipped channel never pulls the fit below white
            clipped = (color >= mi.Vector3f(dr.gather(mi.Float, fit.ceiling, view))) & (off > 0)
            off = dr.select(clipped, 0, off)
            size = dr.abs(off)
            part = dr.select(size < huber, 0.5 * off * off, huber * (size - 0.5 * huber))
            cost += weight * (part.x + part.y + part.z)
            trust = dr.select(off == 0, 0, weight * dr.minimum(1, huber / dr.maximum(size, ROUND)))
            to_d = steep * left * arriving
            to_f = steep * lobe.scale * (light - fit.coupled * x.albedo * arriving)
            rougher = lobe_of(normal, eye, x.level + wider, fit.coupled)
            to_a = steep * (radiance(fit, x, patch, rougher, arriving) - value) / wider
            turned = lobe_of(normal_1, eye, x.level, fit.coupled)
            to_1 = steep * (radiance(fit, x, patch, turned, arriving_1) - value) / TILT_STEP
            turned = lobe_of(normal_2, eye, x.level, fit.coupled)
            to_2 = steep * (radiance(fit, x, patch, turned, arriving_2) - value) / TILT_STEP
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
    hold = fit.holds
    albedo, specular, level = x.albedo - start.albedo, x.specular - start.specular, x.level - start.level
    held = hold.albedo * dr.squared_norm(albedo) + hold.specular * dr.squared_norm(specular)
    held += hold.level * level * level + hold.tilt * (x.along * x.along + x.across * x.across)
    return Equations(
        cost + 0.5 * held,
        (dd + hold.albedo, df, ff + hold.specular),
        (da, d1, d2, fa, f1, f2),
        (aa + hold.level, a1, a2, t11 + hold.tilt, t12, t22 + hold.tilt),
        (
            de + hold.albedo * albedo,
            fe + hold.specular * specular,
            ae + hold.level * level,
            e1 + hold.tilt * x.along,
            e2 + hold.tilt * x.across,
        ),
    )


def step(fit: PointFit, x: State, said: Equations, damping: Any) -> State:
    """The next state of every point, if it is better: albedo and ρs are eliminated channel by channel."""
    (dd, df, ff), (da, d1, d2, fa, f1, f2) = said.colors, said.mixed
    (aa, a1, a2, t11, t12, t22), (de, fe, ae, e1, e2) = said.shared, said.errors
    more = 1 + damping
    dd, ff, aa = dd * more + ROUND, ff * more + ROUND, aa * more + ROUND
    t11, t22 = t11 * more + ROUND, t22 * more + ROUND
    whole = dr.rcp(dr.maximum(dd * ff - df * df, 1e-20))
    i_dd, i_df, i_ff = ff * whole, -df * whole, dd * whole

    def without(p: tuple[Any, Any], q: tuple[Any, Any]) -> Any:
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
    s_a, s_1, s_2 = (dr.rsqrt(dr.maximum(v, ROUND)) for v in (aa, t11, t22))
    c_a = mi.Vector3f(aa * s_a * s_a + 1e-6, a1 * s_a * s_1, a2 * s_a * s_2)
    c_1 = mi.Vector3f(a1 * s_a * s_1, t11 * s_1 * s_1 + 1e-6, t12 * s_1 * s_2)
    c_2 = mi.Vector3f(a2 * s_a * s_2, t12 * s_1 * s_2, t22 * s_2 * s_2 + 1e-6)
    volume = dr.dot(c_a, dr.cross(c_1, c_2))
    inverse = dr.select(volume > 1e-12, dr.rcp(dr.maximum(volume, 1e-12)), 0)
    right = right * mi.Vector3f(s_a, s_1, s_2)
    by_a = dr.clip(s_a * inverse * dr.dot(right, dr.cross(c_1, c_2)), -LONGEST_LEVEL, LONGEST_LEVEL)
    by_1 = dr.clip(s_1 * inverse * dr.dot(right, dr.cross(c_2, c_a)), -LONGEST_TILT, LONGEST_TILT)
    by_2 = dr.clip(s_2 * inverse * dr.dot(right, dr.cross(c_a, c_1)), -LONGEST_TILT, LONGEST_TILT)
    rest_d, rest_f = -de - da * by_a - d1 * by_1 - d2 * by_2, -fe - fa * by_a - f1 * by_1 - f2 * by_2
    albedo = dr.clip(x.albedo + i_dd * rest_d + i_df * rest_f, 0, 1)
    specular = dr.clip(x.specular + i_df * rest_d + i_ff * rest_f, LEAST_RHO, 1)
    # both together reflect no more than arrives; in `dielectric` the albedo is what ρs leaves
    specular = specular if fit.coupled else dr.minimum(specular, dr.maximum(1 - albedo, LEAST_RHO))
    along, across = x.along + by_1, x.across + by_2
    short = _shortened(along, across)
    return State(albedo, specular, dr.clip(x.level + by_a, 0, LEVELS - 1), along * short, across * short)


def radiance(fit: PointFit, x: State, patch: Patch, lobe: Lobe, arriving: Any) -> Any:
    """What points of a state show through a lobe."""
    reflected = x.specular * lobe.scale + lobe.bias
    return x.albedo * dr.maximum(1 - fit.coupled * reflected, 0) * arriving + gathered(patch, lobe) * reflected


def bent_normal(fit: PointFit, along: Any, across: Any) -> Any:
    """`bending.bent` in the frame of each point."""
    short = _shortened(along, across)
    return dr.normalize(fit.normal + short * (along * fit.tangent + across * fit.bitangent))


def arriving_at(fit: PointFit, normal: Any) -> Any:
    """`bending.bent_irradiance`, over π."""
    cosine = dr.dot(fit.normal, normal)
    off = normal - cosine * fit.normal
    turned = mi.Vector3f(*(dr.dot(off, vector) for vector in fit.vectors))
    return dr.maximum((1 + cosine) / 2 * fit.irradiance + turned, 0) / dr.pi


def srgb(value: Any) -> Any:
    """Of linear values; negative ones count as 0."""
    return _srgb_and_slope(value)[0]


def _srgb_and_slope(value: Any) -> tuple[Any, Any]:
    value = dr.maximum(value, 0)
    curved = dr.maximum(value, 0.0031308)
    power = 1.055 * dr.power(curved, 1 / 2.4)
    low = value < 0.0031308
    return dr.select(low, 12.92 * value, power - 0.055), dr.select(low, 12.92, power / (2.4 * curved))


def _shortened(along: Any, across: Any) -> Any:
    return dr.minimum(1, STEEPEST * dr.rsqrt(dr.maximum(along * along + across * across, 1e-20)))
