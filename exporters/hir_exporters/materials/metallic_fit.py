"""Least-squares fits of metallic-roughness and specular-workflow parameters, texel by texel, on the BRDF slice.

Both models and both targets are linear combinations of the six functions `brdf_slice.BASIS`. So a squared difference is
a quadratic form whose 6 x 6 matrix depends on the width alpha only, and optimal values have closed forms whose
coefficients are tabulated. Core glTF is f = b U + C with U = (1 - m) P + m R and C = S + 0.04 (1 - m) R: fitting it to
a function t needs only the inner products <t, P> and <t, R>.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from hir_exporters.materials.brdf_slice import gram_table
from hir_exporters.materials.target_brdfs import CORE_F0
from hir_exporters.textures.texture_maps import map_in_strips, resize

Array = NDArray[np.floating]
_Table = NDArray[np.float64]

_METALNESS_STEPS = np.linspace(0.0, 1.0, 21)
_METALNESS_MAP_SIZE = 256  # texels a side: only the search over metalness has no closed form
_METALNESS_SNAP = 0.04  # metalness within this of 0 or 1 becomes 0 or 1

# Coordinates in BASIS of the terms of core glTF: f = (1 - m) b P + m b R + S + 0.04 (1 - m) R.
_P = np.array([0, 1 - CORE_F0, 0, 0, 0, 0])
_S = np.array([0, 0, 1.0, 0, 0, 0])
_R = np.array([0, 0, 0, 1.0, 0, 0])


def fit_metallic(model: str, diffuse: Array, specular: Array, alpha: Array) -> Array:
    """Metalness (H, W) or () in [0, 1] for which core glTF, with its optimal base colour, is closest to the model.

    Arguments are textures of one size, (H, W, 3) and (H, W), or constants. Computed at 256² texels at most and
    interpolated; values within 0.04 of 0 and 1 become 0 and 1.
    """
    size = next((v.shape[:2] for v, c in ((diffuse, 1), (specular, 1), (alpha, 0)) if v.ndim - c == 2), None)
    if size is not None:
        small = min(size[0], _METALNESS_MAP_SIZE), min(size[1], _METALNESS_MAP_SIZE)
        diffuse, specular = (resize(v, *small) if v.ndim == 3 else v for v in (diffuse, specular))
        alpha = resize(alpha, *small) if alpha.ndim == 2 else alpha

    def nearest(diffuse: Array, specular: Array, alpha: Array) -> Array:
        terms = _CoreProducts(model, diffuse, specular, alpha)
        losses = terms.losses(_METALNESS_STEPS.astype(alpha.dtype))
        return np.asarray(_METALNESS_STEPS[np.argmin(losses, axis=0)])

    metallic = map_in_strips(nearest, (diffuse, 1), (specular, 1), (alpha, 0))
    metallic = np.where(metallic > 1 - _METALNESS_SNAP, 1.0, metallic)
    metallic = np.where(metallic < _METALNESS_SNAP, 0.0, metallic).astype(np.float32)
    return resize(metallic, *size) if size is not None and metallic.ndim == 2 else metallic


def core_base_color(model: str, diffuse: Array, specular: Array, alpha: Array, metallic: Array) -> Array:
    """Base colour (H, W, 3) or (3,) in [0, 1] for which core glTF at that metalness is closest to the model."""

    def best(diffuse: Array, specular: Array, alpha: Array, metallic: Array) -> Array:
        terms = _CoreProducts(
            model, diffuse, specular, np.broadcast_to(alpha, np.broadcast_shapes(alpha.shape, metallic.shape))
        )
        return np.moveaxis(np.clip(terms.numerator(metallic) / terms.denominator(metallic), 0.0, 1.0), 0, -1)

    metallic = np.asarray(metallic, alpha.dtype)
    return map_in_strips(best, (diffuse, 1), (specular, 1), (alpha, 0), (metallic, 0))


def fit_specular_workflow(model: str, diffuse: Array, specular: Array, alpha: Array) -> tuple[Array, Array]:
    """Diffuse and specular colours for which the specular workflow is closest to the model.

    It is X (1 - s)/pi + S + F0 R with X = diffuse (1 - max F0).
    """
    _, gram = gram_table()
    one = np.array([0, 1.0, 0, 0, 0, 0])
    system = np.stack([np.stack([gram[:, 1, 1], gram[:, 1, 3]], -1), np.stack([gram[:, 3, 1], gram[:, 3, 3]], -1)], -2)
    parts = _parts(model)
    rights = [np.stack([gram @ part @ one, gram @ part @ _R], axis=-1) for part in parts]
    solutions = [np.linalg.solve(system, right[..., None])[..., 0] for right in rights]

    # Tables of X, of F0, and of the optimal X for F0 = 0.
    tables = [[_WidthLookup.table(s[:, k]) for s in solutions] for k in (0, 1)]
    tables.append([_WidthLookup.table(right[:, 0] / gram[:, 1, 1]) for right in rights])

    def fitted(diffuse: Array, specular: Array, alpha: Array) -> Array:
        lookup, factors = _WidthLookup(alpha), _factors(model, *_planes(alpha.ndim, diffuse, specular))
        x, f0, alone = (_weighted(factors, [lookup(table) for table in part]) for part in tables)
        x, f0 = np.where(f0 < 0, alone, x), np.clip(f0, 0.0, 0.999)
        reflected = np.maximum(x, 0.0) / (1 - f0.max(axis=0))
        return np.moveaxis(np.concatenate([reflected, f0]), 0, -1).astype(np.float32)

    both = map_in_strips(fitted, (diffuse, 1), (specular, 1), (alpha, 0))
    return both[..., :3], both[..., 3:]


class _CoreProducts:
    """Inner products <t - C, U> and <U, U> at a metalness, for t = a model's texels minus S.

    Their ratio is the optimal base colour. Colours are the first axis, (3, …): sums over long rows take a third of the
    time of sums over three channels.
    """

    def __init__(self, model: str, diffuse: Array, specular: Array, alpha: Array) -> None:
        self._factors = _factors(model, *_planes(alpha.ndim, diffuse, specular))
        tables, lookup = _inner_products(model), _WidthLookup(alpha)
        self._on_p, self._on_r = ([lookup(table) for table in part] for part in tables[:2])
        self._pp, self._pr, self._rr = (lookup(table) for table in tables[2])

    def numerator(self, m: Array) -> Array:
        """<t - C, U> (3, …) at metalness (…). Terms without colour are summed before colours multiply them."""
        p, r = 1 - m, m
        scales = [p * on_p + r * on_r for on_p, on_r in zip(self._on_p, self._on_r, strict=True)]
        return _weighted(self._factors, scales) - np.asarray(CORE_F0, p.dtype) * p * (p * self._pr + r * self._rr)

    def denominator(self, m: Array) -> Array:
        """<U, U> (…)."""
        p, r = 1 - m, m
        return np.asarray(p * p * self._pp + 2 * p * r * self._pr + r * r * self._rr)

    def losses(self, steps: Array) -> list[Array]:
        """Squared difference (…) from core glTF with its optimal base colour at each metalness, summed over channels.

        Terms that do not depend on metalness are left out.
        """
        on_p, on_r = _weighted(self._factors, self._on_p), _weighted(self._factors, self._on_r)
        losses = []
        for m in steps:
            p, r = 1 - m, m
            fixed = np.asarray(CORE_F0, m.dtype) * p  # coefficient of R in C
            numerator = p * on_p + r * on_r - fixed * (p * self._pr + r * self._rr)
            denominator = self.denominator(m)
            base = np.clip(numerator / denominator, 0.0, 1.0)
            constant = fixed * (fixed * self._rr - 2 * on_r)
            losses.append(np.asarray((constant + base * (base * denominator - 2 * numerator)).sum(axis=0)))
        return losses


def _weighted(factors: Sequence[Array], scales: Sequence[Array]) -> Array:
    """The sum (3, …) of factors (3, …) times scales (…)."""
    products = [factor * scale for factor, scale in zip(factors, scales, strict=True)]
    total = products[0]
    for product in products[1:]:
        total = total + product
    return np.asarray(total)


def _planes(axes: int, *colors: Array) -> list[Array]:
    """Textures (…, 3) as (3, …); constants as (3, 1, …, 1), which broadcast with them and with maps of `axes` axes."""
    axes = max(axes, *(color.ndim - 1 for color in colors))
    return [
        color.reshape(3, *[1] * axes) if color.ndim == 1 else np.ascontiguousarray(np.moveaxis(color, -1, 0))
        for color in colors
    ]


@cache
def _inner_products(model: str) -> tuple[list[_Table], list[_Table], list[_Table]]:
    """Inner products of a model's terms with P, of the same with R, and <P, P>, <P, R>, <R, R>, for `_WidthLookup`."""
    _, gram = gram_table()

    def inner(left: _Table, right: _Table) -> _Table:
        return _WidthLookup.table(np.einsum("i,tij,j->t", left, gram, right))

    parts = _parts(model)
    pairs = ((_P, _P), (_P, _R), (_R, _R))
    return [inner(p, _P) for p in parts], [inner(p, _R) for p in parts], [inner(*pair) for pair in pairs]


def _parts(model: str) -> tuple[NDArray[np.float64], ...]:
    """Coordinates in BASIS of the terms of a model minus S, which all targets share; `_factors` multiply them."""
    if model == "paper":
        return np.array([1.0, 0, 0, 0, 0, 0]), np.array([0, 0, 1.0, 1, 0, 0]), -_S
    return np.array([0, 0, 0, 0, 1.0, 0]), np.array([0, 0, 0, 1.0, 0, 0]), np.array([0, 0, 0, 0, 0, -1.0])


def _factors(model: str, diffuse: Array, specular: Array) -> tuple[Array, ...]:
    return diffuse, specular, np.ones((), np.float32) if model == "paper" else diffuse * specular


class _WidthLookup:
    """Looks up functions of alpha for a map of alphas; tables have 4096 entries, evenly spaced in sqrt(alpha)."""

    _STEPS = 4096

    @classmethod
    def table(cls, values: _Table) -> _Table:
        """A table (4096,) interpolated from the values at `gram_table`'s widths."""
        widths, _ = gram_table()
        return np.interp(np.linspace(0.0, 1.0, cls._STEPS), np.sqrt(widths), values)

    def __init__(self, alpha: Array) -> None:
        self._dtype = alpha.dtype
        self._index = np.rint(np.sqrt(np.clip(alpha, 0.0, 1.0)) * (self._STEPS - 1)).astype(np.intp)

    def __call__(self, table: _Table) -> Array:
        return table.astype(self._dtype)[self._index]
