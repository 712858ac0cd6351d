"""The regularizers of a stage with their weights, created from settings, timed, and prepared for a scene."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

from jaxtyping import Float
from torch import Tensor

from hir_core.errors import PluginError
from hir_core.optimization.term_gradients import with_known_gradient
from hir_core.plugins.interfaces import WeightedTerm
from hir_core.plugins.registration import a_value

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import Energy, Regularizer
    from hir_core.plugins.manager import PluginManager
    from hir_core.scene import Scene

RegularizerTables = Mapping[str, Mapping[str, Any] | Literal[False]]
"""The settings of a stage's regularizers, by name."""
PIXELS_OF_A_WEIGHT = 16_384
"""A weight counts against the sum of absolute errors over so many pixels: the default of
`reflectance.gradient.batch_pixels`. For a solver it is divided by their number of channels."""


@dataclass(frozen=True)
class Energies:
    """Prepared regularizers by name, each with its weight."""

    terms: Mapping[str, tuple[float, Energy]]

    def __call__(self, scene: Scene) -> dict[str, Float[Tensor, ""]]:
        """Every term times its weight."""
        return {name: weight * energy(scene) for name, (weight, energy) in self.terms.items()}

    def __bool__(self) -> bool:
        return bool(self.terms)


def prepare_energies(scene: Scene, regularizers: RegularizerTables, plugins: PluginManager, seed: int = 0) -> Energies:
    """The terms in the settings; `false` or weight 0 leaves a term out. `seed` is the run's."""
    created = _created(regularizers, plugins, seed)
    return Energies({name: (weight, _prepared(term, name, scene)) for name, weight, term in created})


def solver_terms(
    regularizers: RegularizerTables, plugins: PluginManager, seed: int, seconds: dict[str, float]
) -> tuple[WeightedTerm, ...]:
    """The same terms for a solver; `seconds` receives the processor time of each, its gradients included."""
    return tuple(
        WeightedTerm(
            name,
            weight / (3 * PIXELS_OF_A_WEIGHT),
            plugins.find("regularizer", name).component.traits,
            partial(_prepare_timed, term, name, seconds),
        )
        for name, weight, term in _created(regularizers, plugins, seed)
    )


def _created(
    regularizers: RegularizerTables, plugins: PluginManager, seed: int
) -> Iterator[tuple[str, float, Regularizer]]:
    for name, table in regularizers.items():
        if table is False:
            continue
        options = {key: value for key, value in table.items() if key != "weight"}
        weight = float(table.get("weight", 1.0))
        if weight != 0:
            yield name, weight, plugins.create("regularizer", name, options, seed)


def _prepared(term: Regularizer, name: str, scene: Scene) -> Energy:
    energy = term.prepare(scene)
    if not callable(energy):
        raise PluginError(
            f"the regularizer {name!r} returned {a_value(energy)} from prepare; return a function of the scene"
        )
    return energy


def _prepare_timed(term: Regularizer, name: str, seconds: dict[str, float], scene: Scene) -> Energy:
    with _timed(seconds, name):
        energy = _prepared(term, name, scene)

    return _TimedNear(energy, name, seconds) if hasattr(energy, "near") else _TimedEnergy(energy, name, seconds)


class _TimedEnergy:
    """Adds the processor time of each evaluation, with its gradient, to `seconds[name]`."""

    def __init__(self, energy: Energy, name: str, seconds: dict[str, float]) -> None:
        self._energy, self._name, self._seconds = energy, name, seconds

    def __call__(self, scene: Scene) -> Float[Tensor, ""]:
        with _timed(self._seconds, self._name):
            return with_known_gradient(self._energy, scene)


class _TimedNear(_TimedEnergy):
    """Of a term with a cheaper form near a scene."""

    def near(self, scene: Scene) -> Energy:
        """That form, timed too."""
        with _timed(self._seconds, self._name):
            return _TimedEnergy(self._energy.near(scene), self._name, self._seconds)  # type: ignore[attr-defined]


@contextmanager
def _timed(seconds: dict[str, float], name: str) -> Iterator[None]:
    began = time.process_time()
    try:
        yield
    finally:
        seconds[name] = seconds.get(name, 0.0) + time.process_time() - began
