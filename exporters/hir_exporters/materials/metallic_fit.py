"""Least-squares fits of metallic-roughness and specular-workflow parameters, texel by texel, on the BRDF slice.

Both models and both targets are sums of the six functions `brdf_slice.BASIS`, so that a squared difference is a
quadratic form in a 6 x 6 matrix of the width alpha alone, and best values have closed forms whose coefficients are
tabulated. Of a target t core glTF, f = b U + C with U = (1 - m) P + m R and C = S + 0.04 (1 - m) R, needs no more than
<t, P> and <t, R>.
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
        terms = _Terms(model, diffuse, specular, alpha)
        losses = terms.losses(_METALNESS_STEPS.astype(alpha.dtype))
        return np.asarray(_METALNESS_STEPS[np.argmin(losses, axis=0)])

    metallic = map_in_strips(nearest, (diffuse, 1), (specular, 1), (alpha, 0))
    metallic = np.where(metallic < _SNAP, 0.0, np.where(metallic > 1 - _SNAP, 1.0, metallic)).astype(np.float32)
    return resize(metallic, *size) if size is not None and metallic.ndim == 2 else metallic


def core_base_color(model: str, diffuse: Array, specular: Array, alpha: Array, metallic: Array) -> Array:
    """Base colour (H, W, 3) or (3,) that brings core glTF at that metalness nearest to the model, cut to [0, 1]."""

    def best(diffuse: Array, specular: Array, alpha: Array, metallic: Array) -> Array:
        terms = _Terms(
            model, diffuse, specular, np.broadcast_to(alpha, np.broadcast_shapes(alpha.shape, metallic.shape))
        )
        return np.moveaxis(np.clip(terms.top(metallic) / terms.bottom(metallic), 0.0, 1.0), 0, -1)

    metallic = np.asarray(metallic, alpha.dtype)
    return map_in_strips(best, (diffuse, 1), (specular, 1), (alpha, 0), (metallic, 0))


def fit_specular_workflow(model: str, diffuse: Array, specular: Array, alpha: Array) -> tuple[Array, Array]:
    """Diffuse and specular colours whose X (1 - s)/pi + S + F0 R, X = diffuse (1 - max F0), is nearest to the model."""
    _, gram = gram_table()
    one = np.array([0, 1.0, 0, 0, 0, 0])
    system = np.stack([np.stack([gram[:, 1, 1], gram[:, 1, 3]], -1), np.stack([gram[:, 3, 1], gram[:, 3, 3]], -1)], -2)
    parts = _parts(model)
    rights = [np.stack([gram @ part @ one, gram @ part @ _R], axis=-1) for part in parts]
    solutions = [np.linalg.solve(system, right[..., None])[..., 0] for right in rights]

    # Of X, of F0, and of the best X for F0 = 0.
    tables = [[_Lookup.table(s[:, k]) for s in solutions] for k in (0, 1)]
    tables.append([_Lookup.table(right[:, 0] / gram[:, 1, 1]) for right in rights])

    def fitted(diffuse: Array, specular: Array, alpha: Array) -> Array:
        lookup, factors = _Lookup(alpha), _factors(model, *_planes(alpha.ndim, diffuse, specular))
        x, f0, alone = (_weighted(factors, [lookup(table) for table in part]) for part in tables)
        x, f0 = np.where(f0 < 0, alone, x), np.clip(f0, 0.0, 0.999)
        reflected = np.maximum(x, 0.0) / (1 - f0.max(axis=0))
        return np.moveaxis(np.concatenate([reflected, f0]), 0, -1).astype(np.float32)

    both = map_in_strips(fitted, (diffuse, 1), (specular, 1), (alpha, 0))
    return both[..., :3], both[..., 3:]


class _Terms:
    """For a model's texels less S, t: <t - C, U> and <U, U>, whose ratio is the best base colour, at a metalness.

    Colours come first here, (3, …): sums over long rows take a third of the time of those over three channels.
    """

    def __init__(self, model: str, diffuse: Array, specular: Array, alpha: Array) -> None:
        self._factors = _factors(model, *_planes(alpha.ndim, diffuse, specular))
        tables, lookup = _inner_products(model), _Lookup(alpha)
        self._on_p, self._on_r = ([lookup(table) for table in part] for part in tables[:2])
        self._pp, self._pr, self._rr = (lookup(table) for table in tables[2])

    def top(self, m: Array) -> Array:
        """<t - C, U> (3, …) at metalness (…): what has no colour is added up before it is multiplied with one."""
        p, r = 1 - m, m
        scales = [p * on_p + r * on_r for on_p, on_r in zip(self._on_p, self._on_r, strict=True)]
        return _weighted(self._factors, scales) - np.asarray(CORE_F0, p.dtype) * p * (p * self._pr + r * self._rr)

    def bottom(self, m: Array) -> Array:
        """<U, U> (…)."""
        p, r = 1 - m, m
        return np.asarray(p * p * self._pp + 2 * p * r * self._pr + r * r * self._rr)

    def losses(self, steps: Array) -> list[Array]:
        """At each metalness the squared difference (…) from core glTF at its best base colour, summed over colour.

        Without what no metalness changes.
        """
        on_p, on_r = _weighted(self._factors, self._on_p), _weighted(self._factors, self._on_r)
        losses = []
        for m in steps:
            p, r = 1 - m, m
            fixed = np.asarray(CORE_F0, m.dtype) * p  # of R in C
            top, bottom = p * on_p + r * on_r - fixed * (p * self._pr + r * self._rr), self.bottom(m)
            base = np.clip(top / bottom, 0.0, 1.0)
            constant = fixed * (fixed * self._rr - 2 * on_r)
            losses.append(np.asarray((constant + base * (base * bottom - 2 * top)).sum(axis=0)))
        return losses


def _weighted(factors: Sequence[Array], scales: Sequence[Array]) -> Array:
    """The sum (3, …) of factors times scales (…)."""
    products = [factor * scale for factor, scale in zip(factors, scales, strict=True)]
    total = products[0]
    for product in products[1:]:
        total = total + product
    return np.asarray(total)


def _planes(axes: int, *colors: Array) -> list[Array]:
    """Textures (…, 3) as (3, …), and constants as (3, 1, …, 1) beside them or beside a map with so many axes."""
    axes = max(axes, *(color.ndim - 1 for color in colors))
    return [
        color.reshape(3, *[1] * axes) if color.ndim == 1 else np.ascontiguousarray(np.moveaxis(color, -1, 0))
        for color in colors
    ]


@cache
def _inner_products(model: str) -> tuple[list[_Table], list[_Table], list[_Table]]:
    """Of the parts of a model with P, of the same with R, and PP, PR and RR, as `_Lookup` reads them."""
    _, gram = gram_table()

    def inner(left: _Table, right: _Table) -> _Table:
        return _Lookup.table(np.einsum("i,tij,j->t", left, gram, right))

    parts = _parts(model)
    pairs = ((_P, _P), (_P, _R), (_R, _R))
    return [inner(p, _P) for p in parts], [inner(p, _R) for p in parts], [inner(*pair) for pair in pairs]


def _parts(model: str) -> tuple[NDArray[np.float64], ...]:
    """Coordinates in BASIS of the terms of a model less S, which all targets reflect; for the factors of `_factors`."""
    if model == "paper":
        return np.array([1.0, 0, 0, 0, 0, 0]), np.array([0, 0, 1.0, 1, 0, 0]), -_S
    return np.array([0, 0, 0, 0, 1.0, 0]), np.array([0, 0, 0, 1.0, 0, 0]), np.array([0, 0, 0, 0, 0, -1.0])


def _factors(model: str, diffuse: Array, specular: Array) -> tuple[Array, ...]:
    return diffuse, specular, np.ones((), np.float32) if model == "paper" else diffuse * specular


class _Lookup:
    """Functions tabulated over `gram_table`'s widths, at every alpha of a map: linear in sqrt(alpha), in 4096 steps."""

    _STEPS = 4096

    @classmethod
    def table(cls, values: _Table) -> _Table:
        """Values (4096,) at even steps of sqrt(alpha) from those at `gram_table`'s widths."""
        widths, _ = gram_table()
        return np.interp(np.linspace(0.0, 1.0, cls._STEPS), np.sqrt(widths), values)

    def __init__(self, alpha: Array) -> None:
        self._dtype = alpha.dtype
        self._index = np.rint(np.sqrt(np.clip(alpha, 0.0, 1.0)) * (self._STEPS - 1)).astype(np.intp)

    def __call__(self, table: _Table) -> Array:
        return table.astype(self._dtype)[self._index]
