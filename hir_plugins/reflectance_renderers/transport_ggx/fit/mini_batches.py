"""The pixels of a fit in blocks: all of them in memory, or as many as an option allows, in turn."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Unknowns
from hir_plugins.reflectance_renderers.transport_ggx.fit.pixel_batches import Block, refresh, specular_blocks
from hir_plugins.reflectance_renderers.transport_ggx.operator.specular_radiance import SpecularBlock


@dataclass(frozen=True, eq=False)
class Stream:
    """Blocks that are made when they are asked for; whoever asks lets the earlier ones go."""

    make: Callable[[Unknowns, int], Block]
    """A block, by its number, with lobes drawn for a state."""
    count: int
    at_once: int
    """Blocks that memory holds."""

    @property
    def turns(self) -> int:
        """1 where all blocks stay in memory."""
        return math.ceil(self.count / self.at_once)

    def draw(self, state: Unknowns, turn: int) -> list[Block]:
        """The blocks of one turn."""
        first = turn % self.turns * self.at_once
        return [self.make(state, i) for i in range(first, min(first + self.at_once, self.count))]

    def each(self, state: Unknowns, model: str) -> Iterator[tuple[Block, SpecularBlock | None]]:
        """All blocks one by one, with their matrices at `state`."""
        for number in range(self.count):
            block = self.make(state, number)
            specular = specular_blocks([block], model)
            refresh([block], specular, state)
            yield block, specular[0]
