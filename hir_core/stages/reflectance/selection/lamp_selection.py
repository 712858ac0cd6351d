"""Whether hypotheses with a lamp near the camera take part: only where the simplest of them is already ahead.

A lamp beside a light in the world explains whatever that light alone explains. Photographs without a flash would pay
for as many hypotheses again and select none of them. One short fit, of the simplest material, says whether distances
and a light that stands still matter. It must be ahead of the light in the world by more than noise: a lamp is one more
freedom, which imitates a light that few steps have not found yet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hir_core.plugins.interfaces import FitT, RefinementT
from hir_core.plugins.model_spec import ModelSpec
from hir_core.stages.reflectance.selection.exposure_selection import BUDGET
from hir_core.stages.reflectance.selection.fit_sequence import fit_cost
from hir_core.stages.reflectance.selection.folded_fits import FoldedFit, FoldedFits, gain_of
from hir_core.stages.reflectance.selection.held_out_comparison import differs
from hir_core.stages.reflectance.selection.hypotheses import contains


@dataclass(frozen=True)
class LampComparison:
    """The simplest hypothesis with a lamp, compared with the nearest one without; in dB."""

    takes_part: bool
    """Whether hypotheses with a lamp are fitted like all others."""
    nearest: ModelSpec
    """The best of the others."""
    gain_db: float
    """Of the lamp, mean over held-out views."""
    standard_error_db: float
    held_out_views: int


def compare_lamp(
    fits: FoldedFits[FitT, RefinementT], others: Sequence[ModelSpec], lamp: ModelSpec, later_cost: float = 0.0
) -> LampComparison:
    """A short fit of the hypothesis with a lamp and of each of the others, which are at least one.

    All are of one kind of material, and are fitted with the budget of the first round, as they are there. `later_cost`:
    expected cost of what follows, for the progress.
    """
    fits.expect((1 + len(others)) * fit_cost(lamp, BUDGET.effort, BUDGET.pixel_share) + later_cost)
    found, *rest = fits.side_by_side([lamp, *others], None, BUDGET.effort, BUDGET.pixel_share)
    nearest = max(rest, key=lambda fit: fit.held_out_db)
    gain, standard_error = gain_of(found, over=nearest)
    return LampComparison(is_ahead_of(found, rest), nearest.spec, gain, standard_error, len(found.errors))


def is_ahead_of(lamp: FoldedFit[FitT], others: Sequence[FoldedFit[FitT]]) -> bool:
    """Whether a fit with a lamp explains held-out views better on average than each of the `others`, and by more than
    noise than one that it contains.
    """
    for other in others:
        gain, standard_error = gain_of(lamp, over=other)
        if gain <= 0 or (contains(lamp.spec, other.spec) and not differs(gain, standard_error, len(other.errors))):
            return False
    return True
