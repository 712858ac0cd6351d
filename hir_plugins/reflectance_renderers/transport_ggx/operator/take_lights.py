"""The lights of several takes: which one lit each photograph, and where its values are in stacked arrays.

Everything that is linear in the light has one block of rows for each take, the first take first. So a row of a matrix
that belongs to a photograph reads the block of its take, and the rest of a fit is independent of takes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from hir_core.capture import Capture


@dataclass(frozen=True, eq=False)
class TakeLights:
    """The takes of N photographs; `of_view` is None where all have one light."""

    count: int = 1
    of_view: Int[Tensor, " N"] | None = None
    """Index of each photograph's take."""

    @classmethod
    def of(cls, capture: Capture, device: torch.device) -> TakeLights:
        """The takes of a capture."""
        count = len(capture.takes)
        return cls(count, torch.tensor(capture.take_numbers, device=device)) if count > 1 else ONE_LIGHT

    def views_of(self, take: int, views: Sequence[int]) -> list[int]:
        """Those of `views` that belong to a take."""
        return list(views) if self.of_view is None else [view for view in views if int(self.of_view[view]) == take]

    def stacked_columns(self, columns: Int[Tensor, "P N"], view: Int[Tensor, " P"], size: int) -> Int[Tensor, "P N"]:
        """Columns of one take's block, of `size` columns, as columns of the stacked blocks."""
        if self.of_view is None:
            return columns
        return columns + (self.of_view[view] * size)[:, None].to(columns)


def light_of_each_take(stacked: Float[Tensor, "TH W 3"], takes: int) -> tuple[Float[Tensor, "H W 3"], ...]:
    """The images of the lights of several takes, which are one below another."""
    return stacked.split(len(stacked) // takes)


ONE_LIGHT = TakeLights()
"""All photographs have one light."""
