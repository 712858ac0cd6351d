"""Least-squares fits of metallic-roughness and specular-workflow parameters, texel by texel, on the BRDF slice.

Both models and both targets are sums of the six functions `brdf_slice.BASIS`, so that a squared difference is a
quadratic form in a 6 x 6 matrix of the width alpha alone, and best values have closed forms whose coefficients are
tabulated.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hir_exporters.brdf_slice import gram_table
from hir_exporters.engine_models import CORE_F0
from hir_exporters.texture_maps import resize

Array = NDArray[np.floating]
_Table = NDArray[np.float64]

_METALNESS_STEPS = np.linspace(0.0, 1.0, 21)
_METALNESS_SIZE = 256  # texels a side: the search over metalness is the one part without a closed form
_SNAP = 0.04

# Coordinates in BASIS of the parts of core glTF: f = (1 - m) b P + m b R + S + 0.04 (1 - m) R.
_P = np.array([0, 1 - CORE_F0, 0, 0, 0, 0])
_S = np.array([0, 0, 1.0, 0, 0, 0])
_R = np.array([0, 0, 0, 1.0, 0, 0])


def fit_metallic(model: str, diffuse: Array, specular: Array, alpha: Array) -> Array:
    """Metalness (H, W) or () in [0, 1] for which core glTF, with its best base colour, comes nearest to the model.

    Arguments are textures of one size, (H, W, 3) and (H, W), or constants. Found at 256² texels at most and
    interpolated; values within 0.04 of 0 and 1 become 0 and 1.
    """
    size = next((v.shape[:2] for v, c in ((diffuse, 1), (specular, 1), (alpha, 0)) if v.ndim - c == 2), None)
    if size is not None:
        small = min(size[0], _METALNESS_SIZE), min(size[1], _METALNESS_SIZE)
        diffuse, specular = (resize(v, *small) if v.ndim == 3 else v for v in (diffuse, specular))
        alpha = resize(alpha, *small) if alpha.ndim == 2 else alpha
    # The loss is a small difference of large terms: float64 here, where the texels are few.
    texels = [value.astype(np.float64) for value in (diffuse, specular, alpha)]
    losses = [_core_loss(model, texels[0], texels[1], texels[2], m) for m in _METALNESS_STEPS]
    metallic = np.asarray(_METALNESS_STEPS[np.argmin(losses, axis=0)])
    metallic = np.where(metallic < _SNAP, 0.0, np.where(metallic > 1 - _SNAP, 1.0, metallic)).astype(np.float32)
    return resize(metallic, *size) if size is not None and metallic.ndim == 2 else metallic


def core_base_color(model: str, diffuse: Array, specular: Array, alpha: Array, metallic: Array) -> Array:
    """Base colour (H, W, 3) or (3,) that brings core glTF at that metalness nearest to the model, cut to [0, 1].

    The best b of f = b U + S + 0.04 (1 - m) R with U = (1 - m) P + m R is <target - S - 0.04 (1 - m) R, U> / <U, U>.
    """
    _, gram = gram_table()
    lookup = _Lookup(alpha)
    m = np.asarray(metallic, alpha.dtype)[..., None]
    parts = _target_parts(model)

    def inner(left: NDArray[np.float64], right: NDArray[np.float64]) -> Array:
        return lookup(np.einsum("i,tij,j->t", left, gram, right))[..., None]

    top = -CORE_F0 * (1 - m) * ((1 - m) * inner(_R, _P) + m * inner(_R, _R))
    top = top - (1 - m) * inner(_S, _P) - m * inner(_S, _R)
    for part, factor in zip(parts, _target_factors(model, diffuse, specular), strict=True):
        top = top + factor * ((1 - m) * inner(part, _P) + m * inner(part, _R))
    bottom = (1 - m) ** 2 * inner(_P, _P) + 2 * (1 - m) * m * inner(_P, _R) + m * m * inner(_R, _R)
    return np.clip(top / bottom, 0.0, 1.0)


def fit_specular_workflow(model: str, diffuse: Array, specular: Array, alpha: Array) -> tuple[Array, Array]:
    """Diffuse and specular colours whose X (1 - s)/pi + S + F0 R, X = diffuse (1 - max F0), is nearest to the model."""
    _, gram = gram_table()
    lookup = _Lookup(alpha)
    one = np.array([0, 1.0, 0, 0, 0, 0])
    system = np.stack([np.stack([gram[:, 1, 1], gram[:, 1, 3]], -1), np.stack([gram[:, 3, 1], gram[:, 3, 3]], -1)], -2)
    solutions = []
    for part in (*_target_parts(model), -_S):
        right = np.stack([gram @ part @ one, gram @ part @ _R], axis=-1)
        solutions.append(np.linalg.solve(system, right[..., None])[..., 0])
    factors = (*_target_factors(model, diffuse, specular), np.ones((), np.float32))
    x, f0 = (sum(f * lookup(s[:, k])[..., None] for f, s in zip(factors, solutions, strict=True)) for k in (0, 1))
    # Where F0 would be negative the best X is that of F0 = 0.
    alone = sum(
        f * lookup(gram @ part @ one / gram[:, 1, 1])[..., None]
        for f, part in zip(factors, (*_target_parts(model), -_S), strict=True)
    )
    x, f0 = np.where(f0 < 0, alone, x), np.clip(f0, 0.0, 0.999)
    reflected = np.maximum(x, 0.0) / (1 - f0.max(axis=-1, keepdims=True))
    return reflected.astype(np.float32), f0.astype(np.float32)


def _core_loss(model: str, diffuse: Array, specular: Array, alpha: Array, m: float) -> Array:
    """Squared weighted difference of core glTF, with its best base colour, and the model, summed over colour."""
    base = core_base_color(model, diffuse, specular, alpha, np.asarray(m))
    _, gram = gram_table()
    lookup = _Lookup(alpha)
    vectors = [*_target_parts(model), -(1 - m) * _P - m * _R, -_S - CORE_F0 * (1 - m) * _R]
    factors = [*_target_factors(model, diffuse, specular), base, np.ones(3, np.float32)]
    loss: Array = np.zeros(())
    for i, (left, a) in enumerate(zip(vectors, factors, strict=True)):
        for right, b in list(zip(vectors, factors, strict=True))[i:]:
            product = lookup(np.einsum("i,tij,j->t", left, gram, right))[..., None]
            loss = loss + (1 if right is left else 2) * product * a * b
    return loss.sum(axis=-1)


def _target_parts(model: str) -> tuple[NDArray[np.float64], ...]:
    """Coordinates in BASIS of the terms of a model, for the factors of `_target_factors`."""
    if model == "paper":
        return np.array([1.0, 0, 0, 0, 0, 0]), np.array([0, 0, 1.0, 1, 0, 0])
    return np.array([0, 0, 0, 0, 1.0, 0]), np.array([0, 0, 0, 1.0, 0, 0]), np.array([0, 0, 0, 0, 0, -1.0]), _S


def _target_factors(model: str, diffuse: Array, specular: Array) -> tuple[Array, ...]:
    if model == "paper":
        return diffuse, specular
    return diffuse, specular, diffuse * specular, np.ones((), np.float32)


class _Lookup:
    """Functions tabulated over `gram_table`'s widths, at every alpha of a map: linear in sqrt(alpha), in 4096 steps."""

    def __init__(self, alpha: Array) -> None:
        self._dtype = alpha.dtype
        self._steps = np.linspace(0.0, 1.0, 4096)
        self._index = np.rint(np.sqrt(np.clip(alpha, 0.0, 1.0)) * 4095).astype(np.int16)

    def __call__(self, values: _Table) -> Array:
        widths, _ = gram_table()
        return np.interp(self._steps, np.sqrt(widths), values).astype(self._dtype)[self._index]
