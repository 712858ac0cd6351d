"""The options of `hir bench materials`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from hir_core.errors import ConfigError

Half = Literal["tuning", "validation"]
HALVES: Final[tuple[Half, ...]] = ("tuning", "validation")

MeshSource = Literal["reconstructed", "truth"]
"""The whole run with its defaults, or material and light alone on the capture's true mesh."""


@dataclass(frozen=True)
class MaterialsOptions:
    """Which captures are run, and how."""

    folder: Path
    """That `python -m benchmarks.materials make` filled."""
    halves: tuple[Half, ...] = HALVES[:1]
    """`validation` is run only to report, never to tune."""
    only: tuple[str, ...] = ()
    """Names or numbers of captures; empty for all."""
    seeds: tuple[int, ...] = (0,)
    mesh: MeshSource = "reconstructed"
    regret: bool = False
    """Whether each hypothesis is also fitted by force."""
    settings: tuple[str, ...] = ()
    """`key=value` of every run, in place of the defaults."""


def parse_seeds(text: str) -> tuple[int, ...]:
    """Seeds from text such as `0,1,2`; `ConfigError` for anything else and for a seed given twice."""
    try:
        seeds = tuple(int(part) for part in text.split(","))
    except ValueError:
        seeds = ()
    if not seeds or min(seeds) < 0 or len(set(seeds)) < len(seeds):
        raise ConfigError(f"--seeds {text!r}: give different whole numbers from 0 up, such as 0,1,2")
    return seeds
