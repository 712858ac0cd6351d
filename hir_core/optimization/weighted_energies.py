"""The regularizers of a stage with their weights, created from settings and prepared for a scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from jaxtyping import Float
from torch import Tensor

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import Energy
    from hir_core.plugins.manager import PluginManager
    from hir_core.scene import Scene


@dataclass(frozen=True)
class Energies:
    """Prepared regularizers by name, each with its weight."""

    terms: Mapping[str, tuple[float, Energy]]

    def __call__(self, scene: Scene) -> dict[str, Float[Tensor, ""]]:
        """Every term times its weight."""
        return {name: weight * energy(scene) for name, (weight, energy) in self.terms.items()}

    def __bool__(self) -> bool:
        return bool(self.terms)


def prepare_energies(
    scene: Scene, regularizers: Mapping[str, Mapping[str, Any] | Literal[False]], plugins: PluginManager, seed: int = 0
) -> Energies:
    """The terms in the settings; `false` or weight 0 leaves a term out. `seed` is the run's."""
    terms: dict[str, tuple[float, Energy]] = {}
    for name, table in regularizers.items():
        if table is False:
            continue
        options = {key: value for key, value in table.items() if key != "weight"}
        weight = float(table.get("weight", 1.0))
        if weight != 0:
            terms[name] = weight, plugins.create("regularizer", name, options, seed).prepare(scene)
    return Energies(terms)
