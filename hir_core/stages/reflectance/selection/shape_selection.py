"""Whether the mesh keeps what photo-consistency or an initializer changed: decided by held-out views of the selected
hypothesis.

Photo-consistency assumes that a point of the surface looks alike from neighbouring views. On a polished object
reflections move over the surface like another surface, and the views that judge photo-consistency see the same
reflections. A fit of material and light explains them, and its held-out error shows which shape they belong to
(docs/studies/photo_consistency.md).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeAlias

from hir_core.plugins.interfaces import FitT, RefinementT, ReflectanceSolver
from hir_core.plugins.model_spec import ModelSpec
from hir_core.stages.reflectance.selection.fit_sequence import FitSequence, fit_cost
from hir_core.stages.reflectance.selection.folded_fits import FoldedFit
from hir_core.stages.reflectance.selection.held_out_comparison import is_significant, paired_gain
from hir_core.stages.reflectance.selection.successive_halving import ROUNDS, Contestant, SuccessiveHalving

OtherShape: TypeAlias = Callable[[], ReflectanceSolver[FitT, RefinementT]]
"""Prepares the scene with another shape. Where it has the same triangles, fits can continue with it."""


@dataclass(frozen=True, eq=False)
class ShapeComparison(Generic[FitT]):
    """The selected hypothesis fitted on the other shape, against the same fits on the refined one."""

    fit: FoldedFit[FitT]
    """The last fit on the other shape."""
    curve_db: tuple[float, ...]
    """Held-out PSNR on the other shape after each round; it ends where it is behind."""
    gain_db: float
    """Mean over held-out views of the last round that both have."""
    standard_error_db: float
    accepted: bool
    """Whether the other shape was selected."""


class OtherMeshSelectedError(Exception):
    """Held-out views prefer a mesh with other triangles: geometry and material are to be fitted again on that one."""

    def __init__(self, comparison: ShapeComparison[FitT]) -> None:
        super().__init__("held-out views prefer the other mesh")
        self.comparison = comparison


def compare_shapes(
    fits: FitSequence[FitT, RefinementT],
    halving: SuccessiveHalving[FitT, RefinementT],
    chosen: Contestant[FitT],
    other_shape: OtherShape[FitT, RefinementT],
    growth_db: float = 0.0,
) -> ShapeComparison[FitT]:
    """Gives the selected hypothesis on the other shape the rounds that it had, as long as it is ahead, or can be where
    it gains `growth_db` on the first shape in each round that is left.

    Where held-out views gain significantly `fits` continues with the solver of the other shape.
    """
    refined, fits.solver = fits.solver, other_shape()
    fit, curve, gain, standard_error = None, [], 0.0, 0.0
    for number, (before, budget) in enumerate(zip(chosen.rounds, ROUNDS, strict=True), 1):
        fit = halving.fit_round(chosen.spec, fit, budget)
        curve.append(fit.held_out_db)
        gain, standard_error = paired_gain(before.errors, fit.errors)
        if gain <= -growth_db * (len(ROUNDS) - number):
            break
    assert fit is not None
    accepted = is_significant(gain, standard_error, len(fit.errors))
    if not accepted:
        fits.solver = refined
    return ShapeComparison(fit, tuple(curve), gain, standard_error, accepted)


def shape_cost(spec: ModelSpec) -> float:
    """Of the rounds of one hypothesis on the other shape, for the progress."""
    return sum(fit_cost(spec, budget.effort, budget.pixel_share) for budget in ROUNDS)
