"""The pixels of a fit in mini-batches: all of them in memory, or one shard of them at a time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.pixel_batches import (
    PixelBatch,
    refresh_matrices,
    specular_matrices,
)
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.specular_radiance import SpecularMatrices


@dataclass(frozen=True, eq=False)
class MiniBatches:
    """Batches that are made on demand and owned by the caller, who can free one shard before making the next."""

    make: Callable[[Parameters, int], PixelBatch]
    """Makes the batch of a number, with lobes sampled for parameters."""
    sample: Callable[[Parameters], PixelBatch]
    """Makes one small batch of pixels of all views, the same each time, with lobes sampled for parameters."""
    count: int
    resident: int
    """Batches in memory at once."""

    @property
    def shards(self) -> int:
        """1 if all batches stay in memory."""
        return math.ceil(self.count / self.resident)

    def numbers(self, shard: int) -> range:
        """The numbers of a shard's batches; shards beyond the last one wrap."""
        first = shard % self.shards * self.resident
        return range(first, min(first + self.resident, self.count))

    def shard(self, parameters: Parameters, number: int) -> list[PixelBatch]:
        """The batches of a shard."""
        return [self.make(parameters, i) for i in self.numbers(number)]

    def each(self, parameters: Parameters, model: str) -> Iterator[tuple[PixelBatch, SpecularMatrices | None]]:
        """All batches one by one, with their specular matrices for `parameters`."""
        for number in range(self.count):
            batch = self.make(parameters, number)
            matrices = specular_matrices([batch], model)
            refresh_matrices([batch], matrices, parameters)
            yield batch, matrices[0]
