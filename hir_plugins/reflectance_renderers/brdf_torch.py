"""The three BRDF models of docs/conventions.md as functions of cosines, on batched tensors (torch).

`paper`: `f = rho_d/pi + rho_s·D·G / (4 (n·wi)(n·wo))`.
`dielectric`: `f = (1 - E) rho_d/pi + F·D·G / (4 (n·wi)(n·wo))` with Schlick's `F = rho_s + (1 - rho_s)(1 - h·wo)^5` and
E the lobe's directional albedo. `metallic`: the same formula with the albedos of `Material.metallic`. D is GGX (Walter
et al. 2007, eq. 33), G Smith's separable form (eq. 23 and 34).

All arguments broadcast. Albedos have a trailing axis of colours; cosines and `alpha` one of length 1. No input makes a
NaN or an infinity in value or gradient: `alpha` is clamped to [ALPHA_MIN, 1], cosines to [0, 1]. So `n·wo` <= 0, which
interpolated normals cause at silhouettes, gives the limit of a grazing view, and `n·wi` <= 0 gives zero.
"""

from __future__ import annotations

from functools import lru_cache
from math import pi
from typing import Literal, TypeAlias

import torch
from hir_exporters.conventions import ALPHA_MIN
from hir_exporters.materials.brdf_numpy import albedo_table
from jaxtyping import Float
from torch import Tensor

Model: TypeAlias = Literal["paper", "dielectric", "metallic"]

_COSINE_MIN = 1e-6
"""Keeps the derivative of the table's square-root coordinate finite."""


def ggx_d(
    cos_h: Float[Tensor, "*#b"], alpha: Float[Tensor, "*#b"], sin2_h: Float[Tensor, "*#b"] | None = None
) -> Float[Tensor, "*b"]:
    """Density of GGX normals: `alpha² / (pi (sin² + alpha² cos²)²)`, Walter et al. 2007 eq. 33.

    In float32 a narrow lobe (alpha < 0.01) needs `sin2_h` = |n × h|²: `1 - cos_h²` loses its precision. The value is
    finite for opposite directions, which have no half vector (both 0).
    """
    alpha2 = alpha.clamp(ALPHA_MIN, 1).square()
    cos_h = cos_h.clamp(0, 1)
    sin2 = (1 - cos_h) * (1 + cos_h) if sin2_h is None else sin2_h.clamp(0, 1)
    return alpha2 / (pi * (sin2 + alpha2 * cos_h.square()).square().clamp_min(1e-24))


def smith_g1(cos: Float[Tensor, "*#b"], alpha: Float[Tensor, "*#b"]) -> Float[Tensor, "*b"]:
    """Smith's masking of one direction, `2 cos / (cos + sqrt(alpha² + (1 - alpha²) cos²))`; 0 for cos <= 0."""
    cos = cos.clamp(0, 1)
    return 2 * cos / _smith_denominator(cos, alpha)


def specular_lobe(
    alpha: Float[Tensor, "*#b"],
    n_wi: Float[Tensor, "*#b"],
    n_wo: Float[Tensor, "*#b"],
    n_h: Float[Tensor, "*#b"],
    sin2_h: Float[Tensor, "*#b"] | None = None,
) -> Float[Tensor, "*b"]:
    """`D·G / (4 n·wo)`: the lobe times `n·wi`, without its albedo. `n·wo` cancels, so grazing views stay finite."""
    masking = 1 / _smith_denominator(n_wo.clamp(0, 1), alpha)
    return ggx_d(n_h, alpha, sin2_h) * smith_g1(n_wi, alpha) * masking / 2


def schlick_weight(h_wo: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """`(1 - h·wo)^5`: Schlick's interpolation from rho_s to 1."""
    x = (1 - h_wo).clamp(0, 1)
    return x.square().square() * x


def directional_albedo_terms(
    cos_o: Float[Tensor, "*#b"], alpha: Float[Tensor, "*#b"]
) -> tuple[Float[Tensor, "*b"], Float[Tensor, "*b"]]:
    """A and B of `E = rho_s·A + B` by `hir_exporters.materials.brdf_numpy.albedo_table`; gradients reach both
    arguments."""
    cos_o, alpha = torch.broadcast_tensors(cos_o, alpha)
    table = _table(cos_o.dtype, cos_o.device)
    rows, columns = table.shape[:2]
    row = cos_o.clamp(_COSINE_MIN, 1).sqrt() * (rows - 1)
    column = (alpha.clamp(ALPHA_MIN, 1).sqrt() - ALPHA_MIN**0.5) * ((columns - 1) / (1 - ALPHA_MIN**0.5))
    i = row.detach().floor().long().clamp(0, rows - 2)
    j = column.detach().floor().long().clamp(0, columns - 2)
    s, t = (row - i)[..., None], (column - j)[..., None]
    near = table[i, j] * (1 - t) + table[i, j + 1] * t
    far = table[i + 1, j] * (1 - t) + table[i + 1, j + 1] * t
    a, b = (near * (1 - s) + far * s).unbind(-1)
    return a, b


def directional_albedo(
    cos_o: Float[Tensor, "*#b 1"], alpha: Float[Tensor, "*#b 1"], rho_s: Float[Tensor, "*#b c"]
) -> Float[Tensor, "*b c"]:
    """E of the `dielectric` lobe: the share of light from `wo` that it reflects, in [0, 1] for rho_s in [0, 1]."""
    a, b = directional_albedo_terms(cos_o, alpha)
    return rho_s * a + b


def evaluate(
    model: Model,
    rho_d: Float[Tensor, "*#b c"],
    rho_s: Float[Tensor, "*#b c"],
    alpha: Float[Tensor, "*#b 1"],
    n_wi: Float[Tensor, "*#b 1"],
    n_wo: Float[Tensor, "*#b 1"],
    n_h: Float[Tensor, "*#b 1"],
    h_wo: Float[Tensor, "*#b 1"],
    sin2_h: Float[Tensor, "*#b 1"] | None = None,
) -> Float[Tensor, "*b c"]:
    """`f · (n·wi)`, the BRDF times the cosine of the light; `sin2_h` as in `ggx_d`."""
    lobe = specular_lobe(alpha, n_wi, n_wo, n_h, sin2_h)
    cosine = n_wi.clamp(0, 1) / pi
    if model == "paper":
        return rho_d * cosine + rho_s * lobe
    if model in ("dielectric", "metallic"):
        grazing = schlick_weight(h_wo)
        fresnel = rho_s * (1 - grazing) + grazing
        diffuse_share = (1 - directional_albedo(n_wo, alpha, rho_s)).clamp_min(0)  # the table rounds to 1 + 1e-15
        return diffuse_share * rho_d * cosine + fresnel * lobe
    raise ValueError(f"unknown BRDF model {model!r}; known are 'paper', 'dielectric' and 'metallic'")


def _smith_denominator(cos: Tensor, alpha: Tensor) -> Tensor:
    alpha2 = alpha.clamp(ALPHA_MIN, 1).square()
    return cos + (alpha2 + (1 - alpha2) * cos.square()).sqrt()


@lru_cache(maxsize=8)
def _table(dtype: torch.dtype, device: torch.device) -> Tensor:
    return torch.from_numpy(albedo_table().copy()).to(device=device, dtype=dtype)
