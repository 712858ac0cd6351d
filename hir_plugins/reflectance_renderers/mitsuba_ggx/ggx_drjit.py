"""The two BRDF models of brdf.py for Dr.Jit arrays, and directions drawn from them.

Directions are unit vectors about the normal (0, 0, 1). `eye` is wo, towards the camera; `light` is wi.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import drjit as dr
import mitsuba as mi
from hir_exporters.conventions import ALPHA_MIN
from hir_exporters.materials.brdf_numpy import albedo_table

from hir_plugins.reflectance_renderers.drjit_arrays import floats

_EYE_MIN = 1e-3
"""Sampling, unlike evaluation, lifts eyes below the shading horizon above it: any density above zero is right."""
_LEAST = 0.1
"""Least probability of each lobe: the derivative of a lobe that is black now needs samples too."""


@dataclass(frozen=True)
class Reflectance:
    """Parameters of the BRDF at one point; `model` is the same for all."""

    model: str
    diffuse: Any
    """Color3f."""
    specular: Any
    alpha: Any
    """Float."""


def evaluate(r: Reflectance, eye: Any, light: Any) -> Any:
    """`f · (n·wi)` as Color3f; what brdf.evaluate computes, digit for digit in its order of operations."""
    half = _half(eye, light)
    alpha = _held(r.alpha)
    n_wi, n_wo = dr.clip(light.z, 0, 1), dr.clip(eye.z, 0, 1)
    lobe = _ggx(half, alpha) * (2 * n_wi / _denominator(n_wi, alpha)) / _denominator(n_wo, alpha) / 2
    cosine = n_wi * dr.inv_pi
    if r.model == "paper":
        return r.diffuse * cosine + r.specular * lobe
    grazing = _fifth(1 - dr.dot(half, eye))
    fresnel = r.specular * (1 - grazing) + grazing
    scale, bias = albedo_terms(n_wo, alpha)
    kept = dr.maximum(1 - (r.specular * scale + bias), 0)
    return kept * r.diffuse * cosine + fresnel * lobe


def sample(r: Reflectance, eye: Any, point: Any) -> Any:
    """A direction drawn with the density of `pdf`, from a point of the unit square; not differentiated."""
    eye, alpha, p = _lifted(eye), dr.detach(_held(r.alpha)), specular_probability(r, eye)
    specular = point.x < p
    u = dr.select(specular, point.x / p, (point.x - p) / (1 - p))
    u = mi.Point2f(dr.clip(u, 0, dr.one_minus_epsilon(mi.Float)), point.y)
    cosine = mi.warp.square_to_cosine_hemisphere(u)
    return dr.select(specular, _reflect(eye, _visible_normal(eye, alpha, u)), cosine)


def pdf(r: Reflectance, eye: Any, light: Any) -> Any:
    """Density per steradian of `sample`; 0 below the horizon. Not differentiated."""
    eye, alpha, p = _lifted(eye), dr.detach(_held(r.alpha)), specular_probability(r, eye)
    half = _half(eye, light)
    # visible normals: G1(eye) D / (4 eye.z), where eye.z cancels
    lobe = _ggx(half, alpha) / (2 * _denominator(eye.z, alpha))
    density = p * lobe + (1 - p) * dr.maximum(light.z, 0) * dr.inv_pi
    return dr.select(light.z > 0, density, 0)


def specular_probability(r: Reflectance, eye: Any) -> Any:
    """How often `sample` takes the lobe: by the albedos of both parts."""
    specular, diffuse = _mean(dr.detach(r.specular)), _mean(dr.detach(r.diffuse))
    if r.model == "dielectric":
        scale, bias = albedo_terms(eye.z, dr.detach(_held(r.alpha)))
        specular = specular * scale + bias
        diffuse = diffuse * (1 - specular)
    specular, diffuse = dr.maximum(specular, 0), dr.maximum(diffuse, 0)
    return _LEAST + (1 - 2 * _LEAST) * specular / dr.maximum(specular + diffuse, 1e-6)


def albedo_terms(cos_o: Any, alpha: Any) -> tuple[Any, Any]:
    """A and B of the lobe's directional albedo, from the table that all parts of the project share."""
    table, rows, columns = _table(mi.variant())
    x = dr.sqrt(dr.clip(cos_o, 1e-6, 1)) * (rows - 1)
    y = (dr.sqrt(alpha) - ALPHA_MIN**0.5) * ((columns - 1) / (1 - ALPHA_MIN**0.5))
    i = dr.minimum(mi.UInt32(dr.detach(dr.maximum(x, 0))), rows - 2)
    j = dr.minimum(mi.UInt32(dr.detach(dr.maximum(y, 0))), columns - 2)
    s, t = x - mi.Float(i), y - mi.Float(j)
    index = i * columns + j
    near = dr.lerp(dr.gather(mi.Vector2f, table, index), dr.gather(mi.Vector2f, table, index + 1), t)
    index = index + columns
    far = dr.lerp(dr.gather(mi.Vector2f, table, index), dr.gather(mi.Vector2f, table, index + 1), t)
    terms = dr.lerp(near, far, s)
    return terms.x, terms.y


@lru_cache(maxsize=4)
def _table(variant: str) -> tuple[Any, int, int]:
    table = albedo_table()
    return floats(table, mi), table.shape[0], table.shape[1]


def _mean(color: Any) -> Any:
    return (color.x + color.y + color.z) / 3  # dr.mean would average over the lanes too


def _half(eye: Any, light: Any) -> Any:
    total = eye + light
    return total * dr.rsqrt(dr.maximum(dr.squared_norm(total), 1e-20))  # opposite directions have no half vector


def _ggx(half: Any, alpha: Any) -> Any:
    alpha2 = dr.square(alpha)
    cos2 = dr.square(dr.clip(half.z, 0, 1))
    # |n × h|² from the local x and y: 1 - cos² has no digits left for narrow lobes
    spread = dr.square(half.x) + dr.square(half.y) + alpha2 * cos2
    return alpha2 / (dr.pi * dr.square(spread))


def _denominator(cos: Any, alpha: Any) -> Any:
    alpha2 = dr.square(alpha)
    return cos + dr.sqrt(alpha2 + (1 - alpha2) * dr.square(cos))


def _held(alpha: Any) -> Any:
    return dr.clip(alpha, ALPHA_MIN, 1)


def _fifth(x: Any) -> Any:
    x = dr.clip(x, 0, 1)
    return dr.square(dr.square(x)) * x


def _lifted(eye: Any) -> Any:
    return dr.normalize(mi.Vector3f(eye.x, eye.y, dr.maximum(eye.z, _EYE_MIN)))


def _visible_normal(eye: Any, alpha: Any, u: Any) -> Any:
    """A GGX normal visible from `eye` (Dupuy and Benyoub 2023, spherical caps)."""
    stretched = dr.normalize(mi.Vector3f(alpha * eye.x, alpha * eye.y, eye.z))
    z = dr.fma(1 - u.x, 1 + stretched.z, -stretched.z)
    radius = dr.safe_sqrt(1 - z * z)
    sin, cos = dr.sincos(dr.two_pi * u.y)
    half = mi.Vector3f(radius * cos, radius * sin, z) + stretched
    return dr.normalize(mi.Vector3f(alpha * half.x, alpha * half.y, half.z))


def _reflect(eye: Any, half: Any) -> Any:
    return 2 * dr.dot(eye, half) * half - eye
