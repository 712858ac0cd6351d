"""Albedo, ρs, α and normal of single points by damped least squares, each from its photographs alone (Dr.Jit).

Under a known light a point's nine numbers depend on nothing but its own photographs, so all points are solved at once,
one to a lane: Levenberg's and Marquardt's steps on robust differences in sRGB. Albedo and ρs of a channel meet only in
α and the normal, so that the 9×9 system falls into three of 2×2 and one of 3×3. The lobe is one lookup in the
`probes` of the point's cell, towards the direction it has most of its light from (Lagarde & de Rousiers 2014).
"""
# ruff: noqa: TID253

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from hir_plugins.reflectance_renderers.arrays import to_color, to_float, to_torch, to_uint
from hir_plugins.reflectance_renderers.brdf import Model
from hir_plugins.reflectance_renderers.mitsuba_ggx.formulas import albedo_terms
from hir_plugins.reflectance_renderers.transport_ggx.bending import STEEPEST
from hir_plugins.reflectance_renderers.transport_ggx.lobes import LEAST_COSINE, frame
from hir_plugins.reflectance_renderers.transport_ggx.probes import (
    COLUMNS,
    LEVELS,
    NARROWEST,
    ROWS,
    Probes,
    alpha_of,
    level_of,
)
from hir_plugins.reflectance_renderers.transport_ggx.sightings import Sightings

HELD = 1e8
"""Weight of a start that nothing moves."""
LEVEL_STEP, TILT_STEP = 0.2, 0.03
"""Of the derivatives in the level of α and in the normal: one-sided differences."""
LONGEST_LEVEL, LONGEST_TILT = 1.5, 0.4
"""Of one step."""
LEAST_RHO = 0.002
ROUND = 1e-9


@dataclass(frozen=True, eq=False)
class Points:
    """P points and the light at each."""

    position: Float[Tensor, "P 3"]
    normal: Float[Tensor, "P 3"]
    """Of the mesh; unit."""
    cell: Int[Tensor, " P"]
    """Whose probe they take."""
    irradiance: Float[Tensor, "P 3"]
    vectors: Float[Tensor, "P 3 3"]
    """Vector irradiance, axis by axis, then colours (`bending.py`)."""


@dataclass(frozen=True, eq=False)
class PointValues:
    """What is found for each point."""

    albedo: Float[Tensor, "P 3"]
    specular: Float[Tensor, "P 3"]
    alpha: Float[Tensor, "P 1"]
    tilt: Float[Tensor, "P 3"]
    """In the world (`bending.py`)."""

    def where(self, chosen: Tensor, other: PointValues) -> PointValues:
        """These where `chosen` (P,) says so, the others elsewhere."""
        pairs = zip(self.all(), other.all(), strict=True)
        return PointValues(*(torch.where(chosen[:, None], mine, others) for mine, others in pairs))

    def take(self, rows: Tensor) -> PointValues:
        """Those of some of the points."""
        return PointValues(*(value[rows] for value in self.all()))

    def all(self) -> tuple[Tensor, ...]:
        """Albedo, ρs, α and tilt."""
        return self.albedo, self.specular, self.alpha, self.tilt

    @classmethod
    def join(cls, parts: Sequence[PointValues]) -> PointValues:
        """One behind the other."""
        return cls(*(torch.cat(values) for values in zip(*(part.all() for part in parts), strict=True)))


class ProbeTable:
    """Probes where Dr.Jit reads them."""

    def __init__(self, probes: Probes) -> None:
        self.values = mi.Float16(probes.radiance.reshape(-1).cpu().numpy())


@dataclass(frozen=True)
class Holds:
    """Weights of the start beside a photograph that sees a point straight on, and how far differences are trusted."""

    albedo: float = 0.001
    specular: float = 0.02
    level: float = 0.01
    tilt: float = 0.01
    """On normals that leave the mesh's."""
    huber: float = 0.1
    """In sRGB."""
    iterations: int = 12

    @classmethod
    def of_albedo(cls) -> Holds:
        """Nothing but the albedo moves; its equations are nearly linear."""
        return cls(specular=HELD, level=HELD, tilt=HELD, iterations=6)


@dataclass
class _State:
    """Unknowns of all points; a tree that Dr.Jit's loops can carry."""

    albedo: Any = None
    specular: Any = None
    level: Any = None
    along: Any = None
    across: Any = None
    damping: Any = None


class PointFit:
    """Some points with their photographs, ready to be solved."""

    def __init__(self, points: Points, seen: Sightings, probes: ProbeTable, model: Model, holds: Holds) -> None:
        tangent, bitangent = frame(points.normal)
        self._axes = tangent, bitangent
        self._device = points.position.device
        self.count = len(points.position)
        self.coupled = 1.0 if model == "dielectric" else 0.0
        self.holds = holds
        self.views = mi.UInt32(len(seen.eyes))
        self.place, self.normal = _vector(points.position), _vector(points.normal)
        self.tangent, self.bitangent = _vector(tangent), _vector(bitangent)
        self.irradiance = _vector(points.irradiance)
        self.vectors = [_vector(points.vectors[:, :, channel]) for channel in range(3)]
        self.first = to_uint(points.cell, mi) * (LEVELS * ROWS * COLUMNS)
        self.probes = probes.values
        self.color, self.weight = to_float(seen.color, mi), to_float(seen.weight, mi)
        self.eyes, self.ceiling = to_float(seen.eyes, mi), to_float(seen.ceiling, mi)
        self.start = _State()

    def solve(self, start: PointValues) -> tuple[PointValues, Float[Tensor, " P"]]:
        """What explains each point's photographs best, near `start` where they leave it open, and its cost."""
        state = self._state(start)
        self.start = state
        cost = _cost(self, state)
        dr.eval(cost)
        for _ in range(self.holds.iterations):
            tried = _step(self, state)
            dr.eval(tried)
            dearer = _cost(self, tried)
            better = dearer < cost  # also where either is NaN: the state stays
            for name in ("albedo", "specular", "level", "along", "across"):
                setattr(tried, name, dr.select(better, getattr(tried, name), getattr(state, name)))
            easier, harder = dr.maximum(state.damping * 0.3, 1e-4), dr.minimum(state.damping * 6, 1e4)
            tried.damping = dr.select(better, easier, harder)
            cost = dr.select(better, dearer, cost)
            dr.eval(tried, cost)
            state = tried
        return self._values(state), to_torch(cost, (self.count,), self._device)

    def shown(self, values: PointValues, toward: Float[Tensor, "P 3"]) -> Float[Tensor, "P 3"]:
        """Linear radiance of each point in a direction."""
        state, eye = self._state(values), _vector(toward)
        normal = _bent(self, state.along, state.across)
        return to_color(_radiance(self, state, normal, _arriving(self, normal), eye, state.level), self._device)

    def _state(self, values: PointValues) -> _State:
        tangent, bitangent = self._axes
        state = _State()
        state.albedo = _vector(values.albedo.clamp(0, 1))
        state.specular = _vector(values.specular.clamp(LEAST_RHO, 1))
        state.level = to_float(level_of(values.alpha), mi)
        state.along = to_float((values.tilt * tangent).sum(dim=1), mi)
        state.across = to_float((values.tilt * bitangent).sum(dim=1), mi)
        state.damping = dr.full(mi.Float, 0.01, self.count)
        dr.eval(state)
        return state

    def _values(self, state: _State) -> PointValues:
        tangent, bitangent = self._axes
        along, across, level = (
            to_torch(value, (-1, 1), self._device) for value in (state.along, state.across, state.level)
        )
        albedo, specular = to_color(state.albedo, self._device), to_color(state.specular, self._device)
        return PointValues(albedo, specular, alpha_of(level), along * tangent + across * bitangent)


@dr.syntax
def _cost(fit, x):  # type: ignore[no-untyped-def]
    """Robust squares of all photographs of each point, and of the distance to its start."""
    normal = _bent(fit, x.along, x.across)
    arriving = _arriving(fit, normal)
    lane, view, total = dr.arange(mi.UInt32, fit.count), mi.UInt32(0), dr.zeros(mi.Float, fit.count)
    huber = fit.holds.huber
    while view < fit.views:
        row = view * fit.count + lane
        weight = dr.gather(mi.Float, fit.weight, row)
        if weight > 0:
            eye = dr.normalize(dr.gather(mi.Vector3f, fit.eyes, view) - fit.place)
            off = _difference(fit, _radiance(fit, x, normal, arriving, eye, x.level), row, view)
            size = dr.abs(off)
            part = dr.select(size < huber, 0.5 * off * off, huber * (size - 0.5 * huber))
            total += weight * (part.x + part.y + part.z)
        view += 1
    hold, first = fit.holds, fit.start
    held = hold.albedo * dr.squared_norm(x.albedo - first.albedo) + hold.tilt * (x.along**2 + x.across**2)
    held += hold.specular * dr.squared_norm(x.specular - first.specular) + hold.level * (x.level - first.level) ** 2
    return total + 0.5 * held


@dr.syntax
def _step(fit, x):  # type: ignore[no-untyped-def]
    """The next state of every point, if it is better: albedo and ρs are eliminated channel by channel."""
    normal = _bent(fit, x.along, x.across)
    normal_1, normal_2 = _bent(fit, x.along + TILT_STEP, x.across), _bent(fit, x.along, x.across + TILT_STEP)
    arriving, arriving_1, arriving_2 = _arriving(fit, normal), _arriving(fit, normal_1), _arriving(fit, normal_2)
    wider = dr.select(x.level > LEVELS - 1.5, -LEVEL_STEP, LEVEL_STEP)
    lane, view = dr.arange(mi.UInt32, fit.count), mi.UInt32(0)
    # d: albedo, f: ρs; a: level of α, 1 and 2: tilt; e: what they are to mend
    dd, df, ff, de, fe = (mi.Vector3f(0) for _ in range(5))
    da, d1, d2, fa, f1, f2 = (mi.Vector3f(0) for _ in range(6))
    aa, a1, a2, t11, t12, t22 = (mi.Float(0) for _ in range(6))
    ae, e1, e2 = (mi.Float(0) for _ in range(3))
    while view < fit.views:
        row = view * fit.count + lane
        weight = dr.gather(mi.Float, fit.weight, row)
        if weight > 0:
            eye = dr.normalize(dr.gather(mi.Vector3f, fit.eyes, view) - fit.place)
            lobe, scale, bias = _lobe(fit, normal, eye, x.level)
            left = dr.maximum(1 - fit.coupled * (x.specular * scale + bias), 0)
            value = x.albedo * left * arriving + lobe * (x.specular * scale + bias)
            off = _difference(fit, value, row, view)
            steep = _srgb_slope(value)
            trust = weight * dr.minimum(1, fit.holds.huber / dr.maximum(dr.abs(off), ROUND))
            trust = dr.select(off == 0, 0, trust)
            to_d = steep * left * arriving
            to_f = steep * scale * (lobe - fit.coupled * x.albedo * arriving)
            to_a = steep * (_radiance(fit, x, normal, arriving, eye, x.level + wider) - value) / wider
            to_1 = steep * (_radiance(fit, x, normal_1, arriving_1, eye, x.level) - value) / TILT_STEP
            to_2 = steep * (_radiance(fit, x, normal_2, arriving_2, eye, x.level) - value) / TILT_STEP
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
    hold, first = fit.holds, fit.start
    dd, de = dd + hold.albedo, de + hold.albedo * (x.albedo - first.albedo)
    ff, fe = ff + hold.specular, fe + hold.specular * (x.specular - first.specular)
    aa, ae = aa + hold.level, ae + hold.level * (x.level - first.level)
    t11, e1, t22, e2 = t11 + hold.tilt, e1 + hold.tilt * x.along, t22 + hold.tilt, e2 + hold.tilt * x.across
    more = 1 + x.damping
    dd, ff, aa = dd * more + ROUND, ff * more + ROUND, aa * more + ROUND
    t11, t22 = t11 * more + ROUND, t22 * more + ROUND
    whole = dr.rcp(dr.maximum(dd * ff - df * df, 1e-20))
    i_dd, i_df, i_ff = ff * whole, -df * whole, dd * whole

    def without(p, q):  # type: ignore[no-untyped-def]
        """pᵀ (2×2)⁻¹ q, summed over channels."""
        total = p[0] * (i_dd * q[0] + i_df * q[1]) + p[1] * (i_df * q[0] + i_ff * q[1])
        return total.x + total.y + total.z

    column_a, column_1, column_2, column_e = (da, fa), (d1, f1), (d2, f2), (de, fe)
    aa, a1, a2 = aa - without(column_a, column_a), a1 - without(column_a, column_1), a2 - without(column_a, column_2)
    t11, t12, t22 = (
        t11 - without(column_1, column_1), t12 - without(column_1, column_2), t22 - without(column_2, column_2),
    )  # fmt: skip
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
    tried = _State()
    tried.albedo = dr.clip(x.albedo + i_dd * rest_d + i_df * rest_f, 0, 1)
    tried.specular = dr.clip(x.specular + i_df * rest_d + i_ff * rest_f, LEAST_RHO, 1)
    tried.specular = dr.minimum(tried.specular, _most_specular(fit, tried.albedo))
    tried.level = dr.clip(x.level + by_a, 0, LEVELS - 1)
    along, across = x.along + by_1, x.across + by_2
    short = dr.minimum(1, STEEPEST * dr.rsqrt(dr.maximum(along * along + across * across, 1e-20)))
    tried.along, tried.across = along * short, across * short
    tried.damping = mi.Float(x.damping)
    return tried


def _most_specular(fit, albedo):  # type: ignore[no-untyped-def]
    """Both together reflect no more than arrives; in `dielectric` the albedo is what ρs leaves."""
    return mi.Vector3f(1) if fit.coupled else dr.maximum(1 - albedo, LEAST_RHO)


def _difference(fit, value, row, view):  # type: ignore[no-untyped-def]
    """Fit minus photograph in sRGB; a clipped channel never pulls the fit below white."""
    color = dr.gather(mi.Vector3f, fit.color, row)
    off = _srgb(value) - _srgb(color)
    ceiling = mi.Vector3f(dr.gather(mi.Float, fit.ceiling, view))
    return dr.select((color >= ceiling) & (off > 0), 0, off)


def _bent(fit, along, across):  # type: ignore[no-untyped-def]
    """`bending.bent` in the frame of each point."""
    short = dr.minimum(1, STEEPEST * dr.rsqrt(dr.maximum(along * along + across * across, 1e-20)))
    return dr.normalize(fit.normal + short * (along * fit.tangent + across * fit.bitangent))


def _arriving(fit, normal):  # type: ignore[no-untyped-def]
    """`bending.bent_irradiance`, over π."""
    cosine = dr.dot(fit.normal, normal)
    off = normal - cosine * fit.normal
    turned = mi.Vector3f(*(dr.dot(off, vector) for vector in fit.vectors))
    return dr.maximum((1 + cosine) / 2 * fit.irradiance + turned, 0) / dr.pi


def _radiance(fit, x, normal, arriving, eye, level):  # type: ignore[no-untyped-def]
    lobe, scale, bias = _lobe(fit, normal, eye, level)
    reflected = x.specular * scale + bias
    return x.albedo * dr.maximum(1 - fit.coupled * reflected, 0) * arriving + lobe * reflected


def _lobe(fit, normal, eye, level):  # type: ignore[no-untyped-def]
    """Mean radiance in the lobe, and its albedo as a factor of ρs and what is added to it."""
    alpha = NARROWEST * dr.exp(dr.clip(level, 0, LEVELS - 1) * float(-np.log(NARROWEST) / (LEVELS - 1)))
    cosine = dr.maximum(dr.dot(normal, eye), LEAST_COSINE)
    mirrored = dr.normalize(2 * cosine * normal - eye)
    smooth = 1 - alpha
    mostly = dr.normalize(dr.lerp(normal, mirrored, smooth * (dr.sqrt(dr.maximum(smooth, 0)) + alpha)))
    scale, bias = albedo_terms(cosine, alpha)
    if fit.coupled == 0:
        scale, bias = scale + bias, mi.Float(0)  # the paper's ρs is no F0: it scales all of the lobe
    return _probed(fit, mostly, level), scale, bias


def _probed(fit, direction, level):  # type: ignore[no-untyped-def]
    """Bilinear in the probe, linear between its levels."""
    u = 0.5 - dr.atan2(direction.x, direction.z) / (2 * dr.pi)
    v = dr.atan2(dr.hypot(direction.x, direction.z), direction.y) / dr.pi
    x, y = u * COLUMNS - 0.5, dr.clip(v * ROWS - 0.5, 0, ROWS - 1.001)
    low = dr.clip(level, 0, LEVELS - 1.001)
    left, top, below = mi.Int32(dr.floor(x)), mi.Int32(dr.floor(y)), mi.Int32(dr.floor(low))
    across, down, between = x - left, y - top, low - below
    left = dr.select(left < 0, left + COLUMNS, left)
    right = dr.select(left + 1 >= COLUMNS, 0, left + 1)

    def at(level, row, column):  # type: ignore[no-untyped-def]
        index = fit.first + mi.UInt32((level * ROWS + row) * COLUMNS + column)
        return mi.Vector3f(dr.gather(mi.Array3f16, fit.probes, index))  # type: ignore[arg-type]

    def image(level):  # type: ignore[no-untyped-def]
        upper = dr.lerp(at(level, top, left), at(level, top, right), across)
        return dr.lerp(upper, dr.lerp(at(level, top + 1, left), at(level, top + 1, right), across), down)

    return dr.lerp(image(below), image(below + 1), between)


def _srgb(value):  # type: ignore[no-untyped-def]
    value = dr.maximum(value, 0)
    curve = 1.055 * dr.power(dr.maximum(value, 0.0031308), 1 / 2.4) - 0.055
    return dr.select(value < 0.0031308, 12.92 * value, curve)


def _srgb_slope(value):  # type: ignore[no-untyped-def]
    curve = (1.055 / 2.4) * dr.power(dr.maximum(value, 0.0031308), 1 / 2.4 - 1)
    return dr.select(value < 0.0031308, 12.92, curve)


def _vector(values: Float[Tensor, "P 3"]) -> Any:
    return mi.Vector3f(*(to_float(values[:, axis], mi) for axis in range(3)))
