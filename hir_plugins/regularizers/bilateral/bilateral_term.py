"""What the bilateral regularizers share: samples of a mesh, and the sum of deviations from bilateral means."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, final

import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.scene import Mesh, Scene
from hir_plugins.regularizers.bilateral.bilateral_grid import Cubes, cubes_of
from hir_plugins.regularizers.bilateral.bilateral_pairs import absolute_deviation_of_pairs
from hir_plugins.regularizers.bilateral.grid_deviation import absolute_deviation
from hir_plugins.regularizers.material_options import BilateralOptions
from hir_plugins.regularizers.surface_samples import SurfaceSamples, sample_surface

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import Energy


@dataclass(frozen=True, eq=False)
class SurfaceFilter:
    """Samples, and `absolute_deviation(guide N G in σ, values N D)`: the sum of |values minus their bilateral mean|,
    and the differences themselves, without gradients."""

    samples: SurfaceSamples
    absolute_deviation: Callable[[Tensor, Tensor], tuple[Float[Tensor, ""], Float[Tensor, "N D"]]]


@final
class BilateralEnergy:
    """`Σ ‖values − their bilateral means‖₁` of what `shown(scene)` returns: guide (N, G) in σ and values (N, D)."""

    def __init__(self, smoothing: SurfaceFilter, shown: Callable[[Scene], tuple[Tensor, Tensor]]) -> None:
        self._smoothing, self._shown = smoothing, shown

    def __call__(self, scene: Scene) -> Float[Tensor, ""]:
        return self._smoothing.absolute_deviation(*self._shown(scene))[0]

    def near(self, scene: Scene) -> Energy:
        """The term with its means linear in the maps around those of `scene`: equal value and gradient there.

        The absolute values stay: a value that crosses its mean is drawn back at once.
        """
        guide, values = (part.detach().requires_grad_() for part in self._shown(scene))
        with torch.enable_grad():
            total, deviations = self._smoothing.absolute_deviation(guide, values)
            by_guide, by_values = torch.autograd.grad(total, (guide, values))
        guide, values = guide.detach(), values.detach()
        by_means = by_values - deviations.sign()

        def energy(scene: Scene) -> Float[Tensor, ""]:
            other_guide, other = self._shown(scene)
            change = other - values
            linear = (by_means * change).sum() + (by_guide * (other_guide - guide)).sum()
            # not `other - means`: where a value is nearly its mean, rounding would decide on the sign of the gradient
            return (deviations + change).abs().sum() + linear

        return energy


def surface_filter(mesh: Mesh, shape: Sequence[int], config: BilateralOptions) -> SurfaceFilter:
    """For vertices, or the texels of a texture; σ1 is a fraction of the mesh's bounds.

    `shape` is that of the finest map: (H, W, C), or (V, C) for maps at vertices.
    """
    samples = sample_surface(mesh, config.samples, None if len(shape) == 2 else (int(shape[0]), int(shape[1])))
    positions = samples.positions
    if len(positions) == 0:
        return SurfaceFilter(samples, lambda guide, values: ((guide.sum() + values.sum()) * 0, values * 0))
    low, high = positions.amin(0), positions.amax(0)
    scaled = (positions - low) / (config.sigma_position * max(float((high - low).norm()), 1e-30))
    if config.method == "all_pairs":
        return SurfaceFilter(samples, partial(absolute_deviation_of_pairs, scaled))
    cubes = cubes_of(scaled, config.cutoff, config.cell_size)
    return SurfaceFilter(samples, partial(_by_grid, cubes, config.cell_size))


def _by_grid(cubes: Cubes, edge: float, guide: Tensor, values: Tensor) -> tuple[Tensor, Tensor]:
    """Values that are equal in all channels, such as a grey ρs, are filtered once; each channel has its gradient."""
    channels = values.shape[1]
    if channels == 1 or not bool((values == values[:, :1]).all()):
        return absolute_deviation(cubes, guide, values, edge)
    total, deviations = absolute_deviation(cubes, guide, values.mean(dim=1, keepdim=True), edge)
    return channels * total, deviations.expand(-1, channels)
