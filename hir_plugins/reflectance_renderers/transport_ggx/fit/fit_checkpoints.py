"""Fits on disk, so that an interrupted climb of the ladder repeats none that had ended and goes on inside the last."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch

from hir_core.optimization.checkpoints import Arrays, below, load_checkpoint, read_arrays, save_checkpoint, write_arrays
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Unknowns


class FitFiles:
    """The fits of one stage in their order. The ladder is a function of its settings, so a resume asks for the same."""

    def __init__(self, folder: Path, seconds: float) -> None:
        self._folder = folder
        self._seconds = seconds
        self._asked = 0

    def next(self, *question: Any) -> FitFile:
        """The file of the fit that is asked for now; `question`: all that tells it from another."""
        self._asked += 1
        mark = hashlib.blake2b(repr(question).encode(), digest_size=8).hexdigest()
        return FitFile(self._folder / f"fit_{self._asked}_{mark}", self._seconds)


@dataclass
class FitFile:
    """One fit: its result when it has ended, its state while it runs."""

    stem: Path
    seconds: float
    saved: float = field(default_factory=time.monotonic)

    def result(self) -> Unknowns | None:
        """What the fit ended with, if it did."""
        return unknowns_of(read_arrays(self.stem.with_suffix(".npz")))

    def finish(self, unknowns: Unknowns) -> None:
        """The fit ended with this."""
        write_arrays(self.stem.with_suffix(".npz"), arrays_of(unknowns))
        self._under_way.unlink(missing_ok=True)

    def begun(self) -> bool:
        """Is there a state to go on from?"""
        return self._under_way.exists()

    def save(self, loop: Loop) -> None:
        """Stores the state of a loop if the last one is old enough."""
        if time.monotonic() - self.saved < self.seconds:
            return
        more = {f"drawn/{name}": value for name, value in arrays_of(loop.drawn).items()}
        more |= {"rates": np.array([g["lr"] for g in loop.optimizer.param_groups]), "skipped": np.asarray(loop.skipped)}
        more |= {"scheduled": np.asarray(loop.schedule.last_epoch)}
        save_checkpoint(self._under_way, loop.optimizer, loop.step, more)
        self.saved = time.monotonic()

    def restore(self, loop: Loop) -> bool:
        """Brings a loop to the stored state, whose lobes are then to be drawn for `loop.drawn`; False if there is none
        that fits.
        """
        found = load_checkpoint(self._under_way, loop.optimizer)
        if found is None:
            return False
        loop.step, more = found
        drawn = unknowns_of(below(more, "drawn"))
        assert drawn is not None
        loop.drawn, loop.skipped = drawn.to(loop.drawn.light.device), int(more["skipped"])
        rates = more["rates"].tolist()
        loop.schedule.load_state_dict({"last_epoch": int(more["scheduled"]), "_last_lr": rates})
        for group, rate in zip(loop.optimizer.param_groups, rates, strict=True):
            group["lr"] = rate
        return True

    @property
    def _under_way(self) -> Path:
        return self.stem.with_suffix(".under_way.npz")


@dataclass
class Loop:
    """What changes while a fit runs, beside the unknowns that the optimizer holds."""

    optimizer: torch.optim.Optimizer
    schedule: torch.optim.lr_scheduler.LRScheduler
    drawn: Unknowns
    """The unknowns that the lobes were drawn for."""
    step: int = 0
    skipped: int = 0


def arrays_of(unknowns: Unknowns) -> Arrays:
    """Unknowns as arrays; absent ones are left out."""
    named: Sequence[tuple[str, Any]] = [(f.name, getattr(unknowns, f.name)) for f in fields(unknowns)]
    return {name: value.detach().cpu().numpy() for name, value in named if value is not None}


def unknowns_of(arrays: Arrays) -> Unknowns | None:
    """The inverse of `arrays_of`; None where there is no light."""
    if not {"light", "diffuse"} <= set(arrays):
        return None
    found = {name: torch.from_numpy(np.array(value)) for name, value in arrays.items()}
    others = (found.get(name) for name in ("specular", "width", "gain", "solved", "tilt"))
    return Unknowns(found["light"], found["diffuse"], *others)
