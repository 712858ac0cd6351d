"""Least-squares fits of metallic-roughness and specular-workflow parameters, texel by texel, on the BRDF slice.

Both models and both targets are sums of the six functions `brdf_slice.BASIS`, so that a squared difference is a
quadratic form in a 6 x 6 matrix of the width alpha alone, and best values have closed forms whose coefficients are
tabulated. Of a target t core glTF, f = b U + C with U = (1 - m) P + m R and C = S + 0.04 (1 - m) R, needs no more than
<t, P> and <t, R>.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hir_exporters.brdf_slice import gram_table
from hir_exporters.engine_models import CORE_F0
from hir_exporters.texture_maps import in_strips, resize

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

    def nearest(diffuse: Array, specular: Array, alpha: Array) -> Array:
        seen = _Projected(model, diffuse, specular, alpha)
        losses = [seen.loss(m) for m in _METALNESS_STEPS.astype(alpha.dtype)]
        return np.asarray(_METALNESS_STEPS[np.argmin(losses, axis=0)])

    metallic = in_strips(nearest, (diffuse, 1), (specular, 1), (alpha, 0))
    metallic = np.where(metallic < _SNAP, 0.0, np.where(metallic > 1 - _SNAP, 1.0, metallic)).astype(np.float32)
    return resize(metallic, *size) if size is not None and metallic.ndim == 2 else metallic


def core_base_color(model: str, diffuse: Array, specular: Array, alpha: Array, metallic: Array) -> Array:
    """Base colour (H, W, 3) or (3,) that brings core glTF at that metalness nearest to the model, cut to [0, 1]."""

    def best(diffuse: Array, specular: Array, alpha: Array, metallic: Array) -> Array:
        top, bottom = _Projected(model, diffuse, specular, alpha).base_terms(metallic[..., None])
        return np.clip(top / bottom, 0.0, 1.0)

    metallic = np.asarray(metallic, alpha.dtype)
    return in_strips(best, (diffuse, 1), (specular, 1), (alpha, 0), (metallic, 0))


def fit_specular_workflow(model: str, diffuse: Array, specular: Array, alpha: Array) -> tuple[Array, Array]:
    """Diffuse and specular colours whose X (1 - s)/pi + S + F0 R, X = diffuse (1 - max F0), is nearest to the model."""
    _, gram = gram_table()
    one = np.array([0, 1.0, 0, 0, 0, 0])
    system = np.stack([np.stack([gram[:, 1, 1], gram[:, 1, 3]], -1), np.stack([gram[:, 3, 1], gram[:, 3, 3]], -1)], -2)
    parts = _parts(model)
    rights = [np.stack([gram @ part @ one, gram @ part @ _R], axis=-1) for part in parts]
    solutions = [np.linalg.solve(system, right[..., None])[..., 0] for right in rights]

    def fitted(diffuse: Array, specular: Array, alpha: Array) -> Array:
        lookup = _Lookup(alpha)
        factors = _factors(model, diffuse, specular)
        x, f0 = (sum(f * lookup(s[:, k])[..., None] for f, s in zip(factors, solutions, strict=True)) for k in (0, 1))
        # Where F0 would be negative the best X is that of F0 = 0.
        alone = sum(
            f * lookup(right[:, 0] / gram[:, 1, 1])[..., None] for f, right in zip(factors, rights, strict=True)
        )
        x, f0 = np.where(f0 < 0, alone, x), np.clip(f0, 0.0, 0.999)
        reflected = np.maximum(x, 0.0) / (1 - f0.max(axis=-1, keepdims=True))
        return np.concatenate([reflected, f0], axis=-1).astype(np.float32)

    both = in_strips(fitted, (diffuse, 1), (specular, 1), (alpha, 0))
    return both[..., :3], both[..., 3:]


class _Projected:
    """A model's texels less S, e, as <e, P> and <e, R>, (…, 3), beside the inner products of P and R (…, 1)."""

    def __init__(self, model: str, diffuse: Array, specular: Array, alpha: Array) -> None:
        _, gram = gram_table()
        lookup = _Lookup(alpha)

        def inner(left: _Table, right: _Table) -> Array:
            return lookup(np.einsum("i,tij,j->t", left, gram, right))[..., None]

        factors, parts = _factors(model, diffuse, specular), _parts(model)
        on_p, on_r = (sum(f * inner(part, side) for f, part in zip(factors, parts, strict=True)) for side in (_P, _R))
        self._on_p, self._on_r = np.asarray(on_p), np.asarray(on_r)
        self._pp, self._pr, self._rr = inner(_P, _P), inner(_P, _R), inner(_R, _R)

    def base_terms(self, m: Array) -> tuple[Array, Array]:
        """<t - C, U> and <U, U>, whose ratio is the best base colour, at metalness m (…, 1) or ()."""
        p, r = 1 - m, m
        top = p * self._on_p + r * self._on_r - np.asarray(CORE_F0, p.dtype) * p * (p * self._pr + r * self._rr)
        return top, p * p * self._pp + 2 * p * r * self._pr + r * r * self._rr

    def loss(self, m: NDArray[np.floating]) -> Array:
        """Squared difference (…) from core glTF at its best base colour, summed over colour, without what has no m."""
        top, bottom = self.base_terms(m)
        base = np.clip(top / bottom, 0.0, 1.0)
        fixed = np.asarray(CORE_F0, m.dtype) * (1 - m)  # of R in C
        constant = fixed * (fixed * self._rr - 2 * self._on_r)
        return np.asarray((constant + base * (base * bottom - 2 * top)).sum(axis=-1))


def _parts(model: str) -> tuple[NDArray[np.float64], ...]:
    """Coordinates in BASIS of the terms of a model less S, which all targets reflect; for the factors of `_factors`."""
    if model == "paper":
        return np.array([1.0, 0, 0, 0, 0, 0]), np.array([0, 0, 1.0, 1, 0, 0]), -_S
    return np.array([0, 0, 0, 0, 1.0, 0]), np.array([0, 0, 0, 1.0, 0, 0]), np.array([0, 0, 0, 0, 0, -1.0])


def _factors(model: str, diffuse: Array, specular: Array) -> tuple[Array, ...]:
    return diffuse, specular, np.ones((), np.float32) if model == "paper" else diffuse * specular


class _Lookup:
    """Functions tabulated over `gram_table`'s widths, at every alpha of a map: linear in sqrt(alpha), in 4096 steps."""

    def __init__(self, alpha: Array) -> None:
        self._dtype = alpha.dtype
        self._steps = np.linspace(0.0, 1.0, 4096)
        self._index = np.rint(np.sqrt(np.clip(alpha, 0.0, 1.0)) * 4095).astype(np.intp)

    def __call__(self, values: _Table) -> Array:
        widths, _ = gram_table()
        return np.interp(self._steps, np.sqrt(widths), values).astype(self._dtype)[self._index]
