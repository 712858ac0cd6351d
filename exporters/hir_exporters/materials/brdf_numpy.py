"""The three BRDF models of an asset in numpy float64, and the directional albedo of the GGX lobe.

`paper`:       f = rho_d / pi + rho_s D G / (4 (n.i)(n.o))                       Zhu et al. 2023, without Fresnel
`dielectric`:  f = (1 - E) rho_d / pi + F D G / (4 (n.i)(n.o)),  F = rho_s + (1 - rho_s)(1 - h.o)^5  (Schlick 1994)
`metallic`:    `dielectric` with rho_d = (1 - m) base, rho_s = (1 - m) F0 + m base         glTF 2.0, appendix B.3.5

D is GGX (Walter et al. 2007), G is Smith's separable form, E is the lobe's directional albedo at n.o. All directions
are unit vectors; values are 0 where a direction is below the surface, and finite for alpha from ALPHA_MIN to 1.
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hir_exporters.conventions import ALPHA_MIN
from hir_exporters.metallic_parameters import DEFAULT_DIELECTRIC_F0
from hir_exporters.textures.bilinear import sample_bilinear

Array = NDArray[np.float64]

TABLE_SIZE: Final = 128
"""Rows and columns of `albedo_table`."""

_QUADRATURE_NODES: Final = (64, 48)
"""Rows and columns at which the integrals of `albedo_table` are computed; the rest is interpolated."""


def ggx_distribution(cos_h: ArrayLike, alpha: ArrayLike) -> Array:
    """D, in 1/sr, at the cosine between normal and half vector (Walter et al. 2007, eq. 33).

    NaN raises `ValueError`.
    """
    cos_h, squared = np.asarray(cos_h, np.float64), _squared(alpha)
    if np.isnan(cos_h).any() or np.isnan(squared).any():
        raise ValueError("the cosine or the GGX width is NaN")
    # 1 - c^2 + c^2 a^2 instead of c^2 (a^2 - 1) + 1 avoids cancellation for narrow lobes.
    root = (1 - cos_h) * (1 + cos_h) + cos_h * cos_h * squared
    return np.where(cos_h > 0, squared / (np.pi * root * root), 0.0)


def smith_visibility(cos_i: ArrayLike, cos_o: ArrayLike, alpha: ArrayLike) -> Array:
    """G / (4 (n.i)(n.o)) with Smith's separable G (glTF 2.0, appendix B.3.2); finite at grazing angles, 0 below the
    surface.
    """
    cos_i, cos_o, squared = np.asarray(cos_i, np.float64), np.asarray(cos_o, np.float64), _squared(alpha)
    up_i, up_o = np.maximum(cos_i, 0.0), np.maximum(cos_o, 0.0)
    term_i = up_i + np.sqrt(squared + (1 - squared) * up_i * up_i)
    term_o = up_o + np.sqrt(squared + (1 - squared) * up_o * up_o)
    return np.where((cos_i > 0) & (cos_o > 0), 1.0 / (term_i * term_o), 0.0)


def schlick_weight(cos_d: ArrayLike) -> Array:
    """(1 - h.o)^5 for the cosine between the half vector and one of the two directions."""
    return (1 - np.clip(np.asarray(cos_d, np.float64), 0.0, 1.0)) ** 5


def paper_brdf(wi: ArrayLike, wo: ArrayLike, diffuse: ArrayLike, specular: ArrayLike, alpha: ArrayLike) -> Array:
    """f (..., 3) in 1/sr of the `paper` model for unit directions (..., 3) about the normal (0, 0, 1)."""
    cos_i, cos_o, cos_h, _ = half_vector_cosines(wi, wo)
    lobe = (ggx_distribution(cos_h, alpha) * smith_visibility(cos_i, cos_o, alpha))[..., None]
    value = np.asarray(diffuse, np.float64) / np.pi + np.asarray(specular, np.float64) * lobe
    return np.where(((cos_i > 0) & (cos_o > 0))[..., None], value, 0.0)


def dielectric_brdf(wi: ArrayLike, wo: ArrayLike, diffuse: ArrayLike, specular: ArrayLike, alpha: ArrayLike) -> Array:
    """f (..., 3) in 1/sr of the `dielectric` model for unit directions (..., 3) about the normal (0, 0, 1)."""
    cos_i, cos_o, cos_h, cos_d = half_vector_cosines(wi, wo)
    f0 = np.asarray(specular, np.float64)
    fresnel = f0 + (1 - f0) * schlick_weight(cos_d)[..., None]
    lobe = (ggx_distribution(cos_h, alpha) * smith_visibility(cos_i, cos_o, alpha))[..., None]
    alpha = np.broadcast_to(alpha, np.shape(cos_o))
    transmitted = np.maximum(1 - directional_albedo(cos_o[..., None], alpha[..., None], f0), 0.0)
    value = transmitted * np.asarray(diffuse, np.float64) / np.pi + fresnel * lobe
    return np.where(((cos_i > 0) & (cos_o > 0))[..., None], value, 0.0)


def metallic_brdf(
    wi: ArrayLike,
    wo: ArrayLike,
    base_color: ArrayLike,
    metalness: ArrayLike,
    alpha: ArrayLike,
    dielectric_f0: float = DEFAULT_DIELECTRIC_F0,
) -> Array:
    """f (..., 3) in 1/sr of the `metallic` model for unit directions (..., 3) about the normal (0, 0, 1).

    `base_color` is (..., 3), `metalness` (...) in 0..1. glTF couples the diffuse part by 1 - F of each direction; here
    it is 1 - E, its average over the lobe, as in `dielectric`.
    """
    base, m = np.asarray(base_color, np.float64), np.asarray(metalness, np.float64)[..., None]
    return dielectric_brdf(wi, wo, (1 - m) * base, (1 - m) * dielectric_f0 + m * base, alpha)


def half_vector_cosines(wi: ArrayLike, wo: ArrayLike) -> tuple[Array, Array, Array, Array]:
    """n.i, n.o, n.h and h.o for unit directions (..., 3) about the normal (0, 0, 1)."""
    wi, wo = np.asarray(wi, np.float64), np.asarray(wo, np.float64)
    half = wi + wo
    length = np.maximum(np.linalg.norm(half, axis=-1), 1e-12)  # opposite directions have no half vector
    cos_i, cos_o = np.broadcast_arrays(wi[..., 2], wo[..., 2])
    return cos_i, cos_o, half[..., 2] / length, length / 2


def directional_albedo(cos_theta: ArrayLike, alpha: ArrayLike, f0: ArrayLike) -> Array:
    """E = f0 A + B: the fraction of light from (or to) n.o that the lobe with Schlick's Fresnel term reflects.

    All arguments broadcast; the accuracy is that of `albedo_terms`.
    """
    scale, bias = albedo_terms(cos_theta, alpha)
    return np.asarray(f0, np.float64) * scale + bias


def albedo_terms(cos_theta: ArrayLike, alpha: ArrayLike) -> tuple[Array, Array]:
    """A and B of E = f0 A + B by bilinear lookup in `albedo_table`; A + B is the lobe's albedo without Fresnel.

    Error against converged integration: at most 0.0004 (A) and 0.0013 (B) for n.o > 0.01, root mean square 7e-5 and
    9e-4 over the whole table; up to 0.03 nearer to the horizon, where B of a narrow lobe falls from 1 within n.o of
    about alpha.
    """
    table = albedo_table()
    row, column = table_coordinates(cos_theta, alpha)
    terms = np.asarray(sample_bilinear(table, column, row), np.float64)
    return terms[..., 0], terms[..., 1]


def table_coordinates(cos_theta: ArrayLike, alpha: ArrayLike) -> tuple[Array, Array]:
    """Fractional row and column in `albedo_table`, broadcast together: linear in sqrt(n.o) and in sqrt(alpha)."""
    cos_theta, alpha = np.broadcast_arrays(np.asarray(cos_theta, np.float64), np.asarray(alpha, np.float64))
    lowest = np.sqrt(ALPHA_MIN)
    roughness = (np.sqrt(np.clip(alpha, ALPHA_MIN, 1.0)) - lowest) / (1 - lowest)
    return np.sqrt(np.clip(cos_theta, 0.0, 1.0)) * (TABLE_SIZE - 1), roughness * (TABLE_SIZE - 1)


@cache
def albedo_table() -> Array:
    """A and B (TABLE_SIZE, TABLE_SIZE, 2), read-only: the result of `integrated_table`, stored in albedo_table.npy.

    Rows are evenly spaced in sqrt(n.o) from 0 to 1, columns in sqrt(alpha) from sqrt(ALPHA_MIN) to 1, ends included.
    """
    with (files("hir_exporters.materials") / "albedo_table.npy").open("rb") as stream:
        table: Array = np.load(stream, allow_pickle=False)
    table.setflags(write=False)
    return table


def integrated_table() -> Array:
    """Computes the content of `albedo_table` by integration, in a quarter of a second."""
    rows, columns = (np.linspace(0.0, 1.0, count) for count in _QUADRATURE_NODES)
    lowest = np.sqrt(ALPHA_MIN)
    nodes = integrate_albedo(rows[:, None] ** 2, (lowest + (1 - lowest) * columns[None, :]) ** 2)
    # The integrals are smooth in these coordinates: cubic interpolation between few nodes is accurate enough.
    down, along = (_cubic_weights(count, TABLE_SIZE) for count in _QUADRATURE_NODES)
    scale, bias = (np.clip(down @ term @ along.T, 0.0, 1.0) for term in nodes)
    return np.stack([np.minimum(scale, 1 - bias), bias], axis=-1)  # A + B <= 1 also where a cubic overshoots


def integrate_albedo(
    cos_theta: ArrayLike, alpha: ArrayLike, index: int = 15, *, correlated: bool = False
) -> tuple[Array, Array]:
    """A and B by quadrature over visible half vectors: the mean of G / G1(o) F, which has no peak.

    G / G1(o) is G1(i), or with `correlated` that of Smith's height-correlated G (Heitz 2014, eq. 99).

    `index` is that of the Fibonacci number of lattice points. The default, 987 points, is within 4e-4 of 28657 points;
    the error decreases with about the 1.5th power of the number.
    """
    cos_o, a = np.broadcast_arrays(np.asarray(cos_theta, np.float64), np.asarray(alpha, np.float64))
    a = np.maximum(a, ALPHA_MIN)
    scale, bias = np.zeros(cos_o.shape), np.zeros(cos_o.shape)
    for weight, height, azimuth in _cap_lattice(index):
        cos_h, cos_d = visible_half_vector(cos_o, a, height, azimuth)
        cos_i = np.maximum(2 * cos_d * cos_h - cos_o, 0.0)
        root_i = np.sqrt(a * a + (1 - a * a) * cos_i * cos_i)
        if correlated:
            root_o = np.sqrt(a * a + (1 - a * a) * cos_o * cos_o)
            masking = weight * cos_i * (cos_o + root_o) / np.maximum(cos_i * root_o + cos_o * root_i, 1e-300)
        else:
            masking = weight * 2 * cos_i / (cos_i + root_i)
        fresnel = schlick_weight(cos_d)
        scale += masking * (1 - fresnel)
        bias += masking * fresnel
    return scale, bias


def visible_half_vector(cos_o: Array, alpha: Array, height: ArrayLike, azimuth: ArrayLike) -> tuple[Array, Array]:
    """n.h and h.o of the half vector that the sample (height in 0..1, azimuth) selects among those visible from n.o.

    Uniform heights and azimuths give the density of visible normals (spherical caps, Dupuy and Benyoub 2023).
    """
    sin_o = np.sqrt(np.maximum(1 - cos_o * cos_o, 0.0))
    length = np.hypot(alpha * sin_o, cos_o)
    x, z = alpha * sin_o / length, cos_o / length
    cap_z = (1 - np.asarray(height)) * (1 + z) - z
    cap_r = np.sqrt(np.maximum(1 - cap_z * cap_z, 0.0))
    hx, hy, hz = alpha * (cap_r * np.cos(azimuth) + x), alpha * (cap_r * np.sin(azimuth)), cap_z + z
    length = np.maximum(np.sqrt(hx * hx + hy * hy + hz * hz), 1e-300)
    return hz / length, np.clip((hx * sin_o + hz * cos_o) / length, 0.0, 1.0)


def _cubic_weights(nodes: int, points: int) -> Array:
    """(points, nodes) interpolation matrix between evenly spaced positions in [0, 1]: cubics through four nodes."""
    position = np.linspace(0.0, nodes - 1, points)
    start = np.clip(position.astype(np.int64) - 1, 0, nodes - 4)
    t = position - start
    weights = np.zeros((points, nodes))
    for k in range(4):
        others = [j for j in range(4) if j != k]
        weights[np.arange(points), start + k] = np.prod([(t - j) / (k - j) for j in others], axis=0)
    return weights


def _cap_lattice(index: int) -> list[tuple[float, float, float]]:
    """Weight, height in 0..1 and azimuth of a Fibonacci lattice; heights are mapped smoothly at both ends."""
    step, count = 1, 1
    for _ in range(index - 1):
        step, count = count, step + count
    points = []
    for number in range(count):
        s = (number + 0.5) / count
        height, density = s * s * (3 - 2 * s), 6 * s * (1 - s)
        points.append((density / count, height, 2 * np.pi * (number * step / count % 1.0)))
    return points


def _squared(alpha: ArrayLike) -> Array:
    return np.maximum(np.asarray(alpha, np.float64), ALPHA_MIN) ** 2
