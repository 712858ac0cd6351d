"""The BRDF models of `brdf_torch` for Dr.Jit arrays, and importance sampling.

Directions are unit vectors about the normal (0, 0, 1). `eye` is wo, towards the camera; `light` is wi.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import drjit as dr
import mitsuba as mi
from hir_exporters.conventions import ALPHA_MIN
from hir_exporters.materials.brdf_numpy import albedo_table

from hir_plugins.reflectance_renderers.drjit_arrays import floats
from hir_plugins.reflectance_renderers.drjit_bilinear import bilinear, clamped
from hir_plugins.reflectance_renderers.drjit_types import DrJitArray

_EYE_MIN = 1e-3
"""Sampling, unlike evaluation, moves eyes below the shading horizon above it: every positive density is unbiased."""
_MIN_PROBABILITY = 0.1
"""Of each lobe: the derivative of a black lobe needs samples too."""


@dataclass(frozen=True)
class Reflectance:
    """Parameters of the BRDF at one point; `model` is the same for all. The albedos of `metallic` are its lobes'."""

    model: str
    diffuse: DrJitArray
    """Color3f."""
    specular: DrJitArray
    alpha: DrJitArray
    """Float."""


def metallic_reflectance(
    base_color: DrJitArray, metalness: DrJitArray, alpha: DrJitArray, dielectric_f0: float
) -> Reflectance:
    """The lobes of glTF's parameters (glTF 2.0, appendix B.3.5): Color3f, Float, Float, and one number."""
    share = 1 - metalness
    return Reflectance("metallic", base_color * share, share * dielectric_f0 + base_color * metalness, alpha)


def evaluate(r: Reflectance, eye: DrJitArray, light: DrJitArray) -> DrJitArray:
    """`f · (n·wi)` as Color3f; the operations and their order are those of `brdf_torch.evaluate`."""
    half = _half(eye, light)
    alpha = clamped_alpha(r.alpha)
    n_wi, n_wo = dr.clip(light.z, 0, 1), dr.clip(eye.z, 0, 1)
    lobe = _ggx(half, alpha) * (2 * n_wi / smith_denominator(n_wi, alpha)) / smith_denominator(n_wo, alpha) / 2
    cosine = n_wi * dr.inv_pi
    if r.model == "paper":
        return r.diffuse * cosine + r.specular * lobe
    grazing = fifth(1 - dr.dot(half, eye))
    fresnel = r.specular * (1 - grazing) + grazing
    scale, bias = albedo_terms(n_wo, alpha)
    diffuse_share = dr.maximum(1 - (r.specular * scale + bias), 0)
    return diffuse_share * r.diffuse * cosine + fresnel * lobe


def sample(r: Reflectance, eye: DrJitArray, point: DrJitArray) -> DrJitArray:
    """A direction drawn with the density of `pdf`, from a point of the unit square; not differentiated."""
    eye, alpha, p = above_horizon(eye), dr.detach(clamped_alpha(r.alpha)), specular_probability(r, eye)
    specular = point.x < p
    u = dr.select(specular, point.x / p, (point.x - p) / (1 - p))
    u = mi.Point2f(dr.clip(u, 0, dr.one_minus_epsilon(mi.Float)), point.y)
    cosine = mi.warp.square_to_cosine_hemisphere(u)
    return dr.select(specular, _reflect(eye, visible_normal(eye, alpha, u)), cosine)


def pdf(r: Reflectance, eye: DrJitArray, light: DrJitArray) -> DrJitArray:
    """Density per steradian of `sample`; 0 below the horizon. Not differentiated."""
    eye, alpha, p = above_horizon(eye), dr.detach(clamped_alpha(r.alpha)), specular_probability(r, eye)
    half = _half(eye, light)
    density = p * visible_lobe(half, eye, alpha) + (1 - p) * dr.maximum(light.z, 0) * dr.inv_pi
    return dr.select(light.z > 0, density, 0)


def visible_lobe(half: DrJitArray, eye: DrJitArray, alpha: DrJitArray) -> DrJitArray:
    """Density per steradian of reflections at visible normals: G1(eye) D / (4 eye.z), where eye.z cancels.

    `alpha` is at least `ALPHA_MIN`.
    """
    return _ggx(half, alpha) / (2 * smith_denominator(eye.z, alpha))


def specular_probability(r: Reflectance, eye: DrJitArray) -> DrJitArray:
    """Probability with which `sample` draws from the specular lobe: by the albedos of both parts."""
    specular, diffuse = _mean(dr.detach(r.specular)), _mean(dr.detach(r.diffuse))
    if r.model != "paper":
        scale, bias = albedo_terms(eye.z, dr.detach(clamped_alpha(r.alpha)))
        specular = specular * scale + bias
        diffuse = diffuse * (1 - specular)
    specular, diffuse = dr.maximum(specular, 0), dr.maximum(diffuse, 0)
    return _MIN_PROBABILITY + (1 - 2 * _MIN_PROBABILITY) * specular / dr.maximum(specular + diffuse, 1e-6)


def albedo_terms(cos_o: DrJitArray, alpha: DrJitArray) -> tuple[DrJitArray, DrJitArray]:
    """A and B of the lobe's directional albedo, from `hir_exporters.materials.brdf_numpy.albedo_table`."""
    table, rows, columns = _table(mi.variant())
    x = dr.sqrt(dr.clip(cos_o, 1e-6, 1)) * (rows - 1)
    y = (dr.sqrt(alpha) - ALPHA_MIN**0.5) * ((columns - 1) / (1 - ALPHA_MIN**0.5))
    terms = bilinear(
        lambda row, column: dr.gather(mi.Vector2f, table, row * columns + column),
        clamped(y, columns),
        clamped(x, rows),
    )
    return terms.x, terms.y


@lru_cache(maxsize=4)
def _table(variant: str) -> tuple[DrJitArray, int, int]:
    table = albedo_table()
    return floats(table, mi), table.shape[0], table.shape[1]


def _mean(color: DrJitArray) -> DrJitArray:
    return (color.x + color.y + color.z) / 3  # dr.mean would average over the lanes too


def _half(eye: DrJitArray, light: DrJitArray) -> DrJitArray:
    total = eye + light
    return total * dr.rsqrt(dr.maximum(dr.squared_norm(total), 1e-20))  # opposite directions have no half vector


def _ggx(half: DrJitArray, alpha: DrJitArray) -> DrJitArray:
    alpha2 = dr.square(alpha)
    cos2 = dr.square(dr.clip(half.z, 0, 1))
    # |n × h|² from the local x and y: 1 - cos² loses its precision for narrow lobes
    sum_of_squares = dr.square(half.x) + dr.square(half.y) + alpha2 * cos2
    return alpha2 / (dr.pi * dr.square(sum_of_squares))


def smith_denominator(cos: DrJitArray, alpha: DrJitArray) -> DrJitArray:
    """2 cos / G1 of a direction."""
    alpha2 = dr.square(alpha)
    return cos + dr.sqrt(alpha2 + (1 - alpha2) * dr.square(cos))


def clamped_alpha(alpha: DrJitArray) -> DrJitArray:
    """α within the limits of the BRDF."""
    return dr.clip(alpha, ALPHA_MIN, 1)


def fifth(x: DrJitArray) -> DrJitArray:
    """The fifth power of a value in 0…1."""
    x = dr.clip(x, 0, 1)
    return dr.square(dr.square(x)) * x


def above_horizon(eye: DrJitArray) -> DrJitArray:
    """A unit direction, raised above the horizon: interpolated normals may face away from it."""
    return dr.normalize(mi.Vector3f(eye.x, eye.y, dr.maximum(eye.z, _EYE_MIN)))


def visible_normal(eye: DrJitArray, alpha: DrJitArray, u: DrJitArray) -> DrJitArray:
    """A GGX normal visible from `eye` (Dupuy and Benyoub 2023, spherical caps).

    The cap's point z = (1 − u)(1 + s) − s, with s the height of the stretched eye, is near −1 at the end of the cap of
    a narrow lobe, where 1 − z² and z + s would cancel in float32. So 1 + z and z + s are sums of positive terms.
    """
    stretched = dr.normalize(mi.Vector3f(alpha * eye.x, alpha * eye.y, eye.z))
    above_one = 1 + stretched.z
    height = (1 - u.x) * above_one
    below_one = (dr.square(stretched.x) + dr.square(stretched.y)) / above_one
    from_end = below_one + height
    radius = dr.safe_sqrt(from_end * (2 - from_end))
    sin, cos = dr.sincos(dr.two_pi * u.y)
    half = mi.Vector3f(radius * cos + stretched.x, radius * sin + stretched.y, height)
    # at the last point of the cap, seen along the normal, the sum is zero
    return dr.normalize(mi.Vector3f(alpha * half.x, alpha * half.y, dr.maximum(half.z, 1e-9)))


def _reflect(eye: DrJitArray, half: DrJitArray) -> DrJitArray:
    return 2 * dr.dot(eye, half) * half - eye
