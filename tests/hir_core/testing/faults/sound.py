"""What the broken plugins of this folder are made of: a regularizer without a fault, and its descriptor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from hir_core.plugins import Component
from hir_core.plugins.interfaces import Regularizer


@dataclass(frozen=True)
class Options:
    """Of the term."""

    strength: float = 1.0
    """Factor of the term."""


class Dispersion(Regularizer):
    """Squared distance of all vertices from their mean."""

    def __init__(self, config: Options) -> None:
        self.config = config

    def prepare(self, scene: Any) -> Callable[[Any], Any]:
        return self.energy

    def energy(self, scene: Any) -> Any:
        offsets = scene.mesh.positions - scene.mesh.positions.mean(dim=0)
        return self.config.strength * offsets.square().sum()


def in_one_place(scene: Any) -> Any:
    return replace(scene, mesh=scene.mesh.with_positions(scene.mesh.positions * 0))


def descriptor(target: str, **changes: Any) -> Component:
    """A descriptor that is right but for `changes`."""
    sound: dict[str, Any] = {
        "name": "dispersion",
        "target": target,
        "config": Options,
        "summary": "Keeps vertices together.",
        "traits": frozenset({"differentiable", "rigid_invariant"}),
        "testing": f"{__name__}:in_one_place",
    }
    return Component(**{**sound, **changes})
