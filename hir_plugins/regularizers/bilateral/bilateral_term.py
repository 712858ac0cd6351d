"""The filter of the bilateral regularizers: samples of a mesh, and bilateral means around each of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import partial

from jaxtyping import Float
from torch import Tensor

from hir_core.errors import ConfigError
from hir_core.scene import Mesh
from hir_plugins.regularizers.bilateral.bilateral_grid import cubes_of
from hir_plugins.regularizers.bilateral.bilateral_pairs import absolute_deviation_of_pairs
from hir_plugins.regularizers.bilateral.grid_deviation import absolute_deviation
from hir_plugins.regularizers.material_options import BilateralOptions
from hir_plugins.regularizers.surface_samples import SurfaceSamples, sample_surface


@dataclass(frozen=True, eq=False)
class SurfaceFilter:
    """Samples, and `absolute_deviation(guide N G in σ, values N D)`: the sum of |values minus their bilateral mean|."""

    samples: SurfaceSamples
    absolute_deviation: Callable[[Float[Tensor, "N G"], Float[Tensor, "N D"]], Float[Tensor, ""]]


def surface_filter(mesh: Mesh, shape: Sequence[int], config: BilateralOptions) -> SurfaceFilter:
    """For vertices, or the texels of a texture; σ1 is a fraction of the mesh's bounds.

    `shape` is that of the finest map: (H, W, C), or (V, C) for maps at vertices.
    """
    samples = sample_surface(mesh, config.samples, None if len(shape) == 2 else (int(shape[0]), int(shape[1])))
    positions = samples.positions
    if len(positions) == 0:
        return SurfaceFilter(samples, lambda guide, values: (guide.sum() + values.sum()) * 0)
    low, high = positions.amin(0), positions.amax(0)
    scaled = (positions - low) / (config.sigma_position * max(float((high - low).norm()), 1e-30))
    if config.method == "all_pairs":
        return SurfaceFilter(samples, partial(absolute_deviation_of_pairs, scaled))
    cubes = cubes_of(scaled, config.cutoff, config.cell_size)
    return SurfaceFilter(samples, partial(absolute_deviation, cubes, edge=config.cell_size))


def refuse_empty_widths(name: str, config: BilateralOptions) -> None:
    """`ConfigError` for a width of 0, which would divide by 0."""
    for field in fields(config):
        if (field.name.startswith("sigma") or field.name in ("cutoff", "cell_size")) and getattr(
            config, field.name
        ) <= 0:
            raise ConfigError(f"regularizer {name}: {field.name} must be greater than 0")
