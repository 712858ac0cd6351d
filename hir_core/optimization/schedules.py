"""What a loop does at each step, as functions of the step: random batches and the learning rate."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Batches:
    """Random batches of `size` of `count` items, each item once an epoch.

    A batch is a function of the step, so a resumed loop draws the same ones.
    """

    count: int
    size: int
    seed: int = 0

    def __call__(self, step: int) -> list[int]:
        """Indices of the batch of one step; all of them, in order, if `size` is `count` or more."""
        if self.size >= self.count:
            return list(range(self.count))
        start = step * self.size
        chosen: list[int] = []
        while len(chosen) < self.size:
            epoch, position = divmod(start + len(chosen), self.count)
            order = np.random.default_rng((self.seed, epoch)).permutation(self.count)
            # a batch that spans two epochs must not contain an item twice
            fresh = [int(i) for i in order[position:] if int(i) not in chosen]
            taken = fresh[: self.size - len(chosen)]
            chosen += taken if taken else [next(i for i in range(self.count) if i not in chosen)]
        return chosen


@dataclass(frozen=True)
class Schedule:
    """Learning rate as a factor of each group's own: linear warm-up, then a half cosine down to `end`.

    Without warm-up and with `end` 0 this is SGDR without restarts (Loshchilov & Hutter 2017).
    """

    steps: int
    warmup: int = 0
    end: float = 1.0

    def __call__(self, step: int) -> float:
        if step < self.warmup:
            return (step + 1) / self.warmup
        progress = (step - self.warmup) / max(1, self.steps - self.warmup)
        return self.end + (1 - self.end) * 0.5 * (1 + math.cos(math.pi * min(1.0, progress)))
