"""Successive halving of hypotheses (Jamieson & Talwalkar 2016): all get a small budget, those that can win get more.

Budgets are continued, not restarted, and after a round all have taken equally many steps. A hypothesis is dropped only
where a bound says that it cannot catch up: held-out PSNR grows less from round to round, so it gains at most its last
gain in each round that is left.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Generic, final

from hir_core.plugins.interfaces import FitT, RefinementT
from hir_core.plugins.model_spec import ModelSpec
from hir_core.stages.reflectance.selection.fit_sequence import fit_cost
from hir_core.stages.reflectance.selection.folded_fits import FoldedFit, FoldedFits, gain_of
from hir_core.stages.reflectance.selection.held_out_comparison import SUFFICIENT_DB, critical_value


@dataclass(frozen=True)
class Budget:
    """What a hypothesis gets in one round."""

    effort: float
    pixel_share: float


ROUNDS = (Budget(0.2, 0.1), Budget(0.2, 0.2), Budget(0.4, 0.3))
"""Each round has at least the steps and pixels of the one before."""
DROP_STANDARD_ERRORS = 2.0
"""Of the paired difference: what noise may have taken from a hypothesis that is dropped."""
MIN_GROWTH_DB = 1.0
"""Least bound on the gain of one round: a curve may stand still once before it rises."""
MAX_FIRST_GROWTH_DB = 6.0
"""Bound on what a hypothesis gains on the best one after the first round, where there is no curve yet. More than twice
the largest gap that was made up on the tuning half of the materials benchmark (docs/studies/model_selection.md)."""


@dataclass(eq=False)
class Contestant(Generic[FitT]):
    """A hypothesis and the fits of its rounds."""

    spec: ModelSpec
    rounds: list[FoldedFit[FitT]] = field(default_factory=list)
    gap_db: float = 0.0
    """How far it was behind the best one, in its last round."""
    standard_error_db: float = 0.0
    dropped: bool = False

    @property
    def last(self) -> FoldedFit[FitT]:
        """The fit of its last round."""
        return self.rounds[-1]

    @property
    def curve_db(self) -> list[float]:
        """Held-out PSNR after each round."""
        return [fit.held_out_db for fit in self.rounds]

    def forget_fits(self) -> None:
        """Keeps the errors alone; nothing goes on from the fits. Of a mesh of 200,000 vertices each takes 5 MB."""
        self.rounds[:] = [fit.without_fits() for fit in self.rounds]


@final
class SuccessiveHalving(Generic[FitT, RefinementT]):
    """Runs the rounds; `contestants` are all hypotheses in the order given, with their curves."""

    def __init__(
        self,
        fits: FoldedFits[FitT, RefinementT],
        specs: Sequence[ModelSpec],
        rounds: Sequence[Budget] = ROUNDS,
        later_cost: float = 0.0,
        fitted: Callable[[FoldedFit[FitT]], None] = lambda fit: None,
    ) -> None:
        """`later_cost`: expected cost of what follows the rounds, for the progress; `fitted` receives each fit."""
        self._fits, self._rounds, self._later, self._fitted = fits, tuple(rounds), later_cost, fitted
        self.contestants: list[Contestant[FitT]] = [Contestant(spec) for spec in specs]
        self._most_fits = max((fits.fits_from_nothing(spec) for spec in specs), default=1)

    def run(self) -> list[Contestant[FitT]]:
        """The hypotheses that were fitted in every round, the best one first."""
        alive = self.contestants
        for number, budget in enumerate(self._rounds):
            self._fits.expect(self._cost(alive, number) + self._later)
            # a hypothesis waits for the simpler one that it starts from, so those go first; then the slow ones
            order = sorted(alive, key=lambda each: (self._waits(each), -self._round_cost(each.spec, number)))
            fits = self._fits.in_branches([partial(self._next_round, each, budget) for each in order], self._fitted)
            for contestant, fit in zip(order, fits, strict=True):
                contestant.forget_fits()
                contestant.rounds.append(fit)
            alive = self._survivors(alive, len(self._rounds) - 1 - number)
        return sorted(alive, key=lambda each: -each.last.held_out_db)

    def _next_round(
        self, contestant: Contestant[FitT], budget: Budget, fits: FoldedFits[FitT, RefinementT]
    ) -> FoldedFit[FitT]:
        before = contestant.rounds[-1] if contestant.rounds else None
        return self.fit_round(contestant.spec, before, budget, fits=fits)

    def fit_round(
        self,
        spec: ModelSpec,
        before: FoldedFit[FitT] | None,
        budget: Budget,
        folds: range | None = None,
        fits: FoldedFits[FitT, RefinementT] | None = None,
    ) -> FoldedFit[FitT]:
        """The fit of one round, in a branch of the sequence where `fits` is one. In the first round a hypothesis is
        fitted again until it has as many steps as those whose solver fits a simpler model first: else these would win
        by their steps.
        """
        fits = fits or self._fits
        repeats = 1 if before is not None else self._repeats(spec)
        fit = fits.fit(spec, before, budget.effort, budget.pixel_share, folds=folds)
        for _ in range(repeats - 1):
            fit = fits.fit(spec, fit, budget.effort, budget.pixel_share, folds=folds)
        return fit

    def cost(self, spec: ModelSpec) -> float:
        """Of all rounds of a hypothesis."""
        return sum(self._round_cost(spec, number) for number in range(len(self._rounds)))

    def _waits(self, contestant: Contestant[FitT]) -> int:
        """How many simpler models are fitted before its next fit."""
        return 0 if contestant.rounds else self._fits.fits_from_nothing(contestant.spec) - 1

    def _repeats(self, spec: ModelSpec) -> int:
        return 1 + self._most_fits - self._fits.fits_from_nothing(spec)

    def _round_cost(self, spec: ModelSpec, number: int) -> float:
        budget = self._rounds[number]
        return (1 if number else self._repeats(spec)) * fit_cost(spec, budget.effort, budget.pixel_share)

    def _survivors(self, alive: Sequence[Contestant[FitT]], rounds_left: int) -> list[Contestant[FitT]]:
        best = max(alive, key=lambda each: each.last.held_out_db)
        for contestant in alive:
            contestant.gap_db, contestant.standard_error_db = (
                gain_of(best.last, over=contestant.last) if contestant is not best else (0.0, 0.0)
            )
            contestant.dropped = rounds_left > 0 and not can_catch_up(contestant, rounds_left)
            if contestant.dropped:
                contestant.forget_fits()
        return [contestant for contestant in alive if not contestant.dropped]

    def _cost(self, alive: Sequence[Contestant[FitT]], first_round: int) -> float:
        """Of the rounds from `first_round` on, with as many hypotheses as now."""
        numbers = range(first_round, len(self._rounds))
        return sum(self._round_cost(each.spec, number) for each in alive for number in numbers)


def can_catch_up(contestant: Contestant[FitT], rounds_left: int) -> bool:
    """Whether the bound on the growth of a hypothesis, plus noise, reaches the best one as it is now.

    One that needs no improvement is never out of reach.
    """
    curve = contestant.curve_db
    if curve[-1] >= SUFFICIENT_DB:
        return True
    growth = MAX_FIRST_GROWTH_DB
    if len(curve) > 1:
        growth = rounds_left * max(curve[-1] - curve[-2], MIN_GROWTH_DB)
    noise = critical_value(DROP_STANDARD_ERRORS, len(contestant.last.errors)) * contestant.standard_error_db
    return contestant.gap_db <= growth + noise
