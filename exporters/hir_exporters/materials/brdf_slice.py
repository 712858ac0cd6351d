"""A slice through a BRDF: the directions on which material conversions are fitted and their residuals measured.

There are 7 view angles. Light directions are sampled half from the GGX lobe and half from the cosine, and BRDF values
are weighted as f (n.i) / p, where p is the density of that mixture. So a sharp highlight and the broad remainder have
similar weight, and the error is relative. All samples are fixed lattices: results are reproducible.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hir_exporters.conventions import ALPHA_MIN
from hir_exporters.materials import brdf_numpy

Array = NDArray[np.float64]

VIEW_COSINES: Final = np.sqrt((np.arange(7) + 0.5) / 7)
"""n.o of the slice: each represents the same number of pixels of a distant sphere."""

_DIRECTIONS_PER_DENSITY = 34  # for each view; a Fibonacci number
_LATTICE_STEP = 21  # the Fibonacci number before it

BASIS: Final = ("1/pi", "(1-s)/pi", "s L", "(1-s) L", "(1-B)/pi", "A/pi")
"""Functions whose linear combinations are both models and core glTF; s = (1 - h.o)^5, L = D G / (4 (n.i)(n.o))."""


@dataclass(frozen=True)
class BrdfSlice:
    """Terms of the BRDF at the directions of the slice, for T widths alpha: all arrays (T, 7, 68)."""

    schlick: Array
    """(1 - h.o)^5."""
    lobe: Array
    """D G / (4 (n.i)(n.o))."""
    albedo_scale: Array
    albedo_bias: Array
    """A and B of the lobe's directional albedo at n.o."""
    weight: Array
    """(n.i) / p, 0 where the light is below the surface."""

    def basis(self) -> Array:
        """Weighted values (T, 476, 6) of `BASIS`."""
        s, lobe = self.schlick, self.lobe
        parts = [
            np.ones_like(s) / np.pi,
            (1 - s) / np.pi,
            s * lobe,
            (1 - s) * lobe,
            (1 - self.albedo_bias) / np.pi,
            self.albedo_scale / np.pi,
        ]
        return np.stack([part * self.weight for part in parts], axis=-1).reshape(len(s), -1, len(parts))


def brdf_slice(alpha: ArrayLike) -> BrdfSlice:
    """The slice for widths alpha (T,)."""
    a = np.maximum(np.asarray(alpha, np.float64).reshape(-1, 1, 1), ALPHA_MIN)
    cos_o = np.broadcast_to(VIEW_COSINES[None, :, None], (len(a), len(VIEW_COSINES), 1))
    count, number = _DIRECTIONS_PER_DENSITY, np.arange(_DIRECTIONS_PER_DENSITY)
    height, azimuth = (number + 0.5) / count, 2 * np.pi * (number * _LATTICE_STEP / count % 1.0)

    lobe_h, lobe_d = brdf_numpy.visible_half_vector(cos_o, np.broadcast_to(a, cos_o.shape), height, azimuth)
    lobe_i = 2 * lobe_d * lobe_h - cos_o
    cosine_i = np.broadcast_to(np.sqrt(1 - height), lobe_i.shape)
    cosine_h, cosine_d = _half_vector_cosines(cos_o, cosine_i, azimuth)
    cos_i = np.concatenate([lobe_i, cosine_i], axis=-1)
    cos_h = np.concatenate([lobe_h, cosine_h], axis=-1)
    cos_d = np.concatenate([lobe_d, cosine_d], axis=-1)

    distribution = brdf_numpy.ggx_distribution(cos_h, a)
    masking_o = 2 / (cos_o + np.sqrt(a * a + (1 - a * a) * cos_o * cos_o))  # G1(o) / (n.o)
    density = 0.5 * masking_o * distribution / 4 + 0.5 * np.maximum(cos_i, 0.0) / np.pi
    scale, bias = brdf_numpy.albedo_terms(cos_o, a)
    return BrdfSlice(
        schlick=brdf_numpy.schlick_weight(cos_d),
        lobe=distribution * brdf_numpy.smith_visibility(cos_i, cos_o, a),
        albedo_scale=np.broadcast_to(scale, cos_i.shape),
        albedo_bias=np.broadcast_to(bias, cos_i.shape),
        weight=np.where(cos_i > 0, cos_i / np.maximum(density, 1e-300), 0.0),
    )


def model_brdf(slices: BrdfSlice, model: str, diffuse: Array, specular: Array) -> Array:
    """f (T, 7, 68, 3) of a model of `hir_exporters.materials.brdf_numpy` with albedos (T, 3); those of `metallic` are
    its effective ones.
    """
    d, f0 = diffuse[:, None, None, :], specular[:, None, None, :]
    s, lobe = slices.schlick[..., None], slices.lobe[..., None]
    if model == "paper":
        return d / np.pi + f0 * lobe
    transmitted = 1 - (f0 * slices.albedo_scale[..., None] + slices.albedo_bias[..., None])
    return transmitted * d / np.pi + (f0 + (1 - f0) * s) * lobe


def relative_error(slices: BrdfSlice, converted: Array, reference: Array) -> float:
    """Root mean square of the weighted difference relative to that of `reference`, both (T, 7, 68, 3); 0 is exact."""
    weight = slices.weight[..., None]
    size = float(np.mean((reference * weight) ** 2))
    return float(np.sqrt(np.mean(((converted - reference) * weight) ** 2) / size)) if size > 0 else 0.0


@cache
def gram_table() -> tuple[Array, Array]:
    """Widths (33,), evenly spaced in sqrt(alpha), and the inner products (33, 6, 6) of `BASIS` on their slices."""
    widths = np.linspace(np.sqrt(ALPHA_MIN), 1.0, 33) ** 2
    basis = brdf_slice(widths).basis()
    table = np.einsum("tni,tnj->tij", basis, basis) / basis.shape[1]
    table.setflags(write=False)
    return widths, table


def _half_vector_cosines(cos_o: Array, cos_i: Array, azimuth: Array) -> tuple[Array, Array]:
    """n.h and h.o of directions with these cosines and this azimuth between them."""
    sin_o = np.sqrt(np.maximum(1 - cos_o * cos_o, 0.0))
    sin_i = np.sqrt(np.maximum(1 - cos_i * cos_i, 0.0))
    cos_between = cos_i * cos_o + sin_i * sin_o * np.cos(azimuth)
    cos_d = np.sqrt(np.maximum((1 + cos_between) / 2, 0.0))
    return np.clip((cos_i + cos_o) / np.maximum(2 * cos_d, 1e-12), 0.0, 1.0), cos_d
