"""`--deterministic`: the same files for the same input, seed and machine.

Sums over several threads have no fixed order. Where the order changes bits, a deterministic run uses one thread. The
switch is torch's own, so that third-party components can read it, too.
"""

from __future__ import annotations

import contextlib
import random
import sys
from collections.abc import Iterator

import numpy as np

from hir_core.run.machine import usable_cores

_GOLDEN_RATIO = 0x9E3779B9
"""Its fractional part in 32 bits: multiples of it are far from each other."""


def deterministic_requested() -> bool:
    """Must the current run be reproducible bit for bit?"""
    torch = sys.modules.get("torch")
    return torch is not None and torch.are_deterministic_algorithms_enabled()


def threads(wanted: int) -> int:
    """Threads that a component may use: `wanted`, or 1 in a deterministic run."""
    return 1 if deterministic_requested() else wanted


@contextlib.contextmanager
def determinism(deterministic: bool) -> Iterator[None]:
    """Sets `deterministic_requested()` for the block, with one thread of torch if true; restores both afterwards."""
    import torch

    before, count = torch.are_deterministic_algorithms_enabled(), torch.get_num_threads()
    warn_only = torch.is_deterministic_algorithms_warn_only_enabled()
    torch.use_deterministic_algorithms(deterministic, warn_only=True)
    if deterministic:
        torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(before, warn_only=warn_only)
        torch.set_num_threads(count)
        if deterministic and not before and "drjit" in sys.modules:
            sys.modules["drjit"].set_thread_count(usable_cores())  # ray tracing components set it to 1


def seed_everything(seed: int) -> None:
    """The same random numbers for a stage whether the stages before it ran in this process or were read from disk."""
    import torch

    random.seed(seed)
    np.random.seed(folded_seed(seed))
    torch.manual_seed(folded_seed(seed))


def folded_seed(seed: int) -> int:
    """32 bits of a seed of 64, all of which count: torch's generator of the CPU ignores the upper ones. Seeds below 2³²
    stay.
    """
    return (seed + _GOLDEN_RATIO * (seed >> 32)) & 0xFFFFFFFF
