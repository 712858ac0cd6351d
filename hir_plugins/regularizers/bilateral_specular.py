"""Places that are near and of like diffuse colour have like specular albedo (Zhu et al. 2023)."""
# ruff: noqa: TID253 - implementation module

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from hir_core.errors import ConfigError, StageError
from hir_core.interfaces import Regularizer
from hir_core.scene import Scene
from hir_plugins.regularizers.material_options import BilateralSpecularOptions
from hir_plugins.regularizers.places import places_of

if TYPE_CHECKING:
    from hir_core.interfaces import Energy

_MOST_PAIRS = 60_000_000
"""Neighbours kept in all: about 700 MB."""
_PAIRS = 2_000_000
"""Pairs of places evaluated at once: bounds memory at about 200 MB, also in the backward pass."""


@dataclass(frozen=True, eq=False)
class Neighbourhoods:
    """For each place its q, itself first, and the part of the weight that depends on distance alone."""

    index: Int[Tensor, "N K"]
    weight: Float[Tensor, "N K"]
    """`exp(−‖p − q‖² / 2σ1²)`, times what a drawn neighbour stands for; 0 fills up rows."""


@final
class BilateralSpecular(Regularizer):
    """`R = Σ_p ‖ρs[p] − Σ_q k_pq ρs[q] / Σ_q k_pq‖₁`, `k_pq = exp(−‖p−q‖²/2σ1² − ‖ρd[p]−ρd[q]‖²/2σ2²)`.

    q runs over all places including p. The gradient reaches ρs, and ρd through k. A constant ρs costs nothing.
    """

    def __init__(self, config: BilateralSpecularOptions) -> None:
        for name in ("sigma_position", "sigma_albedo", "cutoff"):
            if getattr(config, name) <= 0:
                raise ConfigError(f"regularizer bilateral_specular: {name} must be greater than 0")
        self._config = config

    def prepare(self, scene: Scene) -> Energy:
        config, material = self._config, scene.material
        if material is None:
            raise StageError("bilateral_specular needs a material; it belongs to the reflectance stage")
        if material.specular_albedo.ndim == 1:
            return _nothing
        places = places_of(scene.mesh, config.places, tuple(material.specular_albedo.shape[:2]))  # type: ignore[arg-type]
        low, high = places.positions.amin(0), places.positions.amax(0)
        sigma = config.sigma_position * max(float((high - low).norm()), 1e-30)
        scaled = (places.positions - low) / sigma
        near = None if config.method == "all_pairs" else neighbourhoods(scaled, config.cutoff, config.neighbours)
        count = len(places.positions)

        def energy(scene: Scene) -> Float[Tensor, ""]:
            assert scene.material is not None
            specular = places.values(scene.material.specular_albedo)
            diffuse = places.values(scene.material.diffuse_albedo) / config.sigma_albedo
            total = all_pairs(scaled, diffuse, specular) if near is None else neighbour_sum(near, diffuse, specular)
            return total / count if config.average else total

        return energy


def all_pairs(
    positions: Float[Tensor, "N 3"], diffuse: Float[Tensor, "N C"], specular: Float[Tensor, "N D"]
) -> Float[Tensor, ""]:
    """R over all pairs, positions and diffuse albedo in units of their σ. Quadratic in time, not in memory."""

    def part(rows: Tensor, d: Tensor, s: Tensor) -> Tensor:
        place = positions.to(d.dtype)
        apart = (place[rows, None] - place).square().sum(-1) + (d[rows, None] - d).square().sum(-1)
        return _deviation(torch.exp(-0.5 * apart), s[rows, None] - s)

    total = specular.new_zeros(())
    for rows in _blocks(len(positions), len(positions), positions.device):
        total = total + checkpoint(part, rows, diffuse, specular, use_reentrant=False)
    return total


def neighbour_sum(
    near: Neighbourhoods, diffuse: Float[Tensor, "N C"], specular: Float[Tensor, "N D"]
) -> Float[Tensor, ""]:
    """R over each place's neighbours; diffuse albedo in units of σ2."""

    def part(rows: Tensor, d: Tensor, s: Tensor) -> Tensor:
        q = near.index[rows]
        kernel = near.weight[rows].to(d.dtype) * torch.exp(-0.5 * (d[rows, None] - d[q]).square().sum(-1))
        return _deviation(kernel, s[rows, None] - s[q])

    total = specular.new_zeros(())
    for rows in _blocks(len(near.index), near.index.shape[1], near.index.device):
        total = total + checkpoint(part, rows, diffuse, specular, use_reentrant=False)
    return total


def neighbourhoods(positions: Float[Tensor, "N 3"], radius: float, limit: int, seed: int = 0) -> Neighbourhoods:
    """Neighbours within `radius` (in σ1); of more than `limit`, as many drawn at random that stand for the rest.

    Time and memory grow with the number of places times that of neighbours: linear in the places with a limit, and
    else as long as σ1 shrinks with their distance.
    """
    from scipy.spatial import cKDTree

    points = positions.detach().cpu().numpy().astype(np.float64)
    tree = cKDTree(points)
    found_in_all = int(tree.query_ball_point(points[:: max(len(points) // 500, 1)], radius, return_length=True).mean())
    if min(found_in_all, limit or found_in_all) * len(points) > _MOST_PAIRS:
        raise ConfigError(
            f"regularizer bilateral_specular: {len(points)} places have about {found_in_all} neighbours each, "
            "too many to keep; use places = 'vertices', a smaller sigma_position, or a limit such as neighbours = 64"
        )
    random = np.random.default_rng(seed)
    chosen: list[np.ndarray] = []
    stands_for: list[np.ndarray] = []
    for start in range(0, len(points), 4096):
        found = tree.query_ball_point(points[start : start + 4096], radius, return_sorted=False)
        for place, row in enumerate(found, start):
            others = np.asarray(row, dtype=np.int64)
            others = others[others != place]
            share = 1.0
            if limit and len(others) > limit:
                share = len(others) / limit
                others = others[random.choice(len(others), limit, replace=False)]
            chosen.append(np.concatenate([[place], others]))
            stands_for.append(np.concatenate([[1.0], np.full(len(others), share)]))
    width = max((len(row) for row in chosen), default=1)
    index = np.repeat(np.arange(len(points))[:, None], width, axis=1)
    weight = np.zeros((len(points), width))
    for place, (row, share_row) in enumerate(zip(chosen, stands_for, strict=True)):
        index[place, : len(row)] = row
        apart = ((points[row] - points[place]) ** 2).sum(axis=1)
        weight[place, : len(row)] = share_row * np.exp(-0.5 * apart)
    device = positions.device
    return Neighbourhoods(torch.from_numpy(index).to(device), torch.from_numpy(weight).float().to(device))


def _deviation(kernel: Float[Tensor, "R K"], difference: Float[Tensor, "R K D"]) -> Float[Tensor, ""]:
    """Σ ‖Σ k (ρs[p] − ρs[q]) / Σ k‖₁: differences first, so equal albedos give exactly 0 and no rounding's sign."""
    mean = (kernel[..., None] * difference).sum(1) / kernel.sum(1, keepdim=True)  # k_pp = 1: never 0
    return mean.abs().sum()


def _blocks(count: int, width: int, device: torch.device) -> Iterator[Tensor]:
    step = max(_PAIRS // max(width, 1), 1)
    for start in range(0, count, step):
        yield torch.arange(start, min(start + step, count), device=device)


def _nothing(scene: Scene) -> Float[Tensor, ""]:
    assert scene.material is not None
    return scene.material.specular_albedo.sum() * 0
