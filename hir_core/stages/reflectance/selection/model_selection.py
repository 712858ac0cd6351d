"""Model selection by complete hypotheses: material and light together, then refinements.

0. Hypotheses with a lamp near the camera take part where the simplest of them is ahead.
1. The simplest hypotheses decide which exposures the photographs have.
2. Each hypothesis starts from its own initial guess; successive halving drops those that cannot catch up.
3. Of those that tie on held-out views the simplest is selected, after a second fold of held-out views.
4. The mesh without what an initializer changed, and the shape from silhouettes alone, are selected where the selected
   hypothesis fits held-out views better with them.
5. Refinements are compared within it. Hypotheses that were near are then compared again with the same refinements.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Generic, Protocol

import numpy as np
from numpy.typing import NDArray

from hir_core.capture.photograph_exposures import Exposures
from hir_core.config import ReflectanceSettings
from hir_core.errors import ConfigError
from hir_core.plugins.interfaces import FitT, RefinementT
from hir_core.plugins.model_spec import ModelSpec
from hir_core.stages.held_out_views import model_selection_folds
from hir_core.stages.reflectance.selection.exposure_selection import (
    ExposureSelection,
    select_exposures,
    simplest_under_each_light,
)
from hir_core.stages.reflectance.selection.fit_sequence import FitSequence, fit_cost
from hir_core.stages.reflectance.selection.folded_fits import (
    FoldedFit,
    FoldedFits,
    gain_of,
    on_more_views,
)
from hir_core.stages.reflectance.selection.held_out_comparison import (
    SUFFICIENT_DB,
    is_near_tie,
    mean_decibels,
)
from hir_core.stages.reflectance.selection.hypotheses import (
    complexity,
    contains,
    hypotheses,
    lamp_hypotheses,
    simplest_of,
)
from hir_core.stages.reflectance.selection.lamp_selection import LampComparison, compare_lamp
from hir_core.stages.reflectance.selection.refinement_selection import (
    Comparison,
    RefinementSelection,
    expected_cost,
    runner_up_cost,
)
from hir_core.stages.reflectance.selection.requested_model import default_spec, forced_spec
from hir_core.stages.reflectance.selection.shape_selection import (
    OtherMeshSelectedError,
    OtherShape,
    ShapeComparison,
    compare_shapes,
    shape_cost,
)
from hir_core.stages.reflectance.selection.successive_halving import (
    MIN_GROWTH_DB,
    ROUNDS,
    Contestant,
    SuccessiveHalving,
    can_catch_up,
)

MAX_RUNNERS_UP = 2
"""Hypotheses that are compared again at the end, the nearest first."""


EQUAL = ExposureSelection("equal")


class SelectionObserver(Protocol):
    """Receives the intermediate results of a model selection."""

    def evaluated(self, held_out_db: float) -> None:
        """The mean PSNR of a fit on the held-out views."""

    def compared(self, comparison: Comparison) -> None:
        """A refinement or a rival was accepted or rejected."""


@dataclass(frozen=True)
class Margin:
    """How far a hypothesis is behind the selected one, with like refinements where they were fitted."""

    spec: ModelSpec
    margin_db: float
    standard_error_db: float
    held_out_views: int

    @property
    def is_near_tie(self) -> bool:
        """Whether the margin is within noise."""
        return is_near_tie(self.margin_db, self.standard_error_db, self.held_out_views)


@dataclass(frozen=True, eq=False)
class Selection(Generic[FitT]):
    """The selected model, its fit, and how it was selected."""

    spec: ModelSpec
    fit: FitT
    hypothesis: ModelSpec
    """The selected hypothesis, without refinements."""
    contestants: tuple[Contestant[FitT], ...] = ()
    """All hypotheses with their curves; empty where nothing was compared."""
    margins: tuple[Margin, ...] = ()
    """Of all other hypotheses, the runner-up first: those that took part in most rounds, then the nearest."""
    comparisons: tuple[Comparison, ...] = ()
    shape: ShapeComparison[FitT] | None = None
    """None where there was one shape."""
    mesh: ShapeComparison[FitT] | None = None
    """With another mesh, which was not selected; None where there was none."""
    exposures: ExposureSelection = EQUAL
    held_out_errors: NDArray[np.float64] | None = None
    """Mean squared errors of the selected model on held-out views; None where nothing was compared."""
    lamp: LampComparison | None = None
    """Whether hypotheses with a lamp took part; None where the settings or the solver leave them out."""

    @property
    def runner_up(self) -> Margin | None:
        """The nearest hypothesis that does not contain the selected one; any other where there is none."""
        others = [each for each in self.margins if not contains(each.spec, self.hypothesis)]
        return next(iter(others or self.margins), None)

    @property
    def is_near_tie(self) -> bool:
        """Whether held-out views hardly distinguish the runner-up, though it says something else."""
        second = self.runner_up
        return second is not None and second.is_near_tie and not contains(second.spec, self.hypothesis)

    @property
    def compared(self) -> bool:
        """Whether held-out views decided anything."""
        return bool(self.contestants)


def select_model(
    fits: FitSequence[FitT, RefinementT],
    settings: ReflectanceSettings,
    views: int,
    observer: SelectionObserver,
    other_shape: OtherShape[FitT, RefinementT] | None = None,
    exposures: Sequence[Exposures] = ("equal",),
    fits_lamp: bool = False,
    takes: Sequence[int] = (),
    exposures_differ: bool = False,
    camera_positions: NDArray[np.float64] | None = None,
    other_mesh: OtherShape[FitT, RefinementT] | None = None,
) -> Selection[FitT]:
    """Fits training views and decides on held-out views.

    A model that the settings name is fitted without a comparison. Where `other_shape` is selected its solver replaces
    that of `fits`. Of several `exposures`, the simplest first, those are selected that held-out views ask for; without
    held-out views the first. `fits_lamp`: whether the solver fits a lamp near the camera. `takes`: the number of each
    view's take, of which each leaves views to the fit. `exposures_differ`: whether photographs show the same places of
    the mesh in different brightness. `camera_positions` (views, 3), around the object at the origin: fitted exposures
    that change smoothly from camera to camera must gain more; without them all count alike. `other_mesh`: the scene
    with other triangles; `OtherMeshSelectedError` where held-out views prefer it.
    """
    folds = model_selection_folds(views, takes)
    forced = forced_spec(settings)
    folded = FoldedFits(fits, folds, camera_positions, takes) if folds else None
    shown = ExposureSelection(exposures[0])
    admitted, lamp = hypotheses(settings), None
    if forced is None and folded is not None and fits_lamp and (lamps := lamp_hypotheses(settings)):
        lamp = _compare_lamp(folded, fits, settings, lamps[0], exposures[0])
        admitted += lamps if lamp.takes_part else []
    if folded is not None and len(exposures) > 1:
        compared = _supported(fits, admitted if forced is None else [simplest_of(forced)])
        later_cost = _hypotheses_cost(compared) if forced is None else fit_cost(forced, 1.0)
        shown = select_exposures(folded, compared, "recorded" in exposures, later_cost, exposures_differ)
    if forced is not None or folded is None:
        spec = _supported(fits, [forced])[0] if forced is not None else _default(fits, settings)
        spec = replace(spec, exposures=shown.exposures)
        return Selection(spec, _fit_single_model(fits, spec, list(range(views))), spec, exposures=shown)

    def fitted(fit: FoldedFit[FitT]) -> None:
        observer.evaluated(fit.held_out_db)

    specs = [replace(each, exposures=shown.exposures) for each in _supported(fits, admitted)]
    costliest = specs[-1]
    others = [each for each in (other_mesh, other_shape) if each is not None]
    later_cost = expected_cost(costliest) + len(others) * shape_cost(costliest)
    halving = SuccessiveHalving(folded, specs, later_cost=later_cost, fitted=fitted)
    finalists = halving.run()
    chosen, pooled = _decide(folded, halving, finalists)
    rivals = [each for each in finalists if each is not chosen and can_catch_up(each, 1)][:MAX_RUNNERS_UP]
    later_cost = expected_cost(chosen.spec) + sum(runner_up_cost(each.spec) for each in rivals)
    mesh, shape = None, None
    if other_mesh is not None and chosen.last.held_out_db < SUFFICIENT_DB:
        folded.expect(len(others) * shape_cost(chosen.spec) + later_cost)
        mesh = compare_shapes(fits, halving, chosen, other_mesh, MIN_GROWTH_DB)
        if mesh.accepted:
            raise OtherMeshSelectedError(mesh)
    if other_shape is not None and chosen.last.held_out_db < SUFFICIENT_DB:
        folded.expect(shape_cost(chosen.spec) + later_cost)
        shape = compare_shapes(fits, halving, chosen, other_shape)
    folded.expect(later_cost)
    first = shape.fit if shape is not None and shape.accepted else chosen.last
    refinement = RefinementSelection(folded, first, fitted, observer.compared)
    if len(exposures) > 1:
        fitted_before = shown.exposures == "fitted"
        compare = refinement.compare_exposures_again if fitted_before else refinement.compare_exposures
        simpler = shown.before if fitted_before else shown.exposures
        shown = compare(shown, exposures_differ and simpler == "equal")
    refinement.refine_vertices()
    winner, finals, rival_fits = chosen, {chosen.spec: refinement.fit}, []
    for rival in rivals:
        if refinement.fit.held_out_db >= SUFFICIENT_DB:
            break
        fit = refinement.compare_runner_up(rival.last, simpler=complexity(rival.spec) < complexity(winner.spec))
        finals[rival.spec] = fit
        rival_fits.append((rival, fit))
        if refinement.fit is fit:
            winner = rival
    if winner is not chosen:
        # it has the refinements that the other one gained from, which may lack one of its own
        folded.expect(expected_cost(refinement.spec))
        refinement.refine_vertices()
    if refinement.spec.light_frame == "camera":
        for rival, fit in rival_fits:
            lowered = refinement.compare_per_texel_of_rival(fit) if refinement.spec.per_texel == "none" else None
            if lowered is not None:
                winner, finals[rival.spec] = rival, lowered
    else:
        refinement.compare_per_texel()
    # an early margin says less than a late one
    margins = [
        (-len(each.rounds), Margin(each.spec, *_margin(winner, each, (finals, pooled))))
        for each in halving.contestants
        if each is not winner
    ]
    margins.sort(key=lambda each: (each[0], each[1].margin_db))
    return Selection(
        refinement.spec,
        refinement.fit.fits[0],
        winner.spec,
        tuple(halving.contestants),
        tuple(margin for _, margin in margins),
        tuple(refinement.comparisons),
        shape,
        mesh,
        shown,
        refinement.fit.errors,
        lamp,
    )


def _compare_lamp(
    folded: FoldedFits[FitT, RefinementT],
    fits: FitSequence[FitT, RefinementT],
    settings: ReflectanceSettings,
    lamp: ModelSpec,
    exposures: Exposures,
) -> LampComparison:
    """The simplest hypothesis with a lamp against those without."""
    own, *others = (
        replace(each, exposures=exposures)
        for each in simplest_under_each_light(_supported(fits, [lamp, *hypotheses(settings)]))
    )
    return compare_lamp(folded, others, own, _hypotheses_cost(_supported(fits, hypotheses(settings))))


def _hypotheses_cost(specs: Sequence[ModelSpec]) -> float:
    """About that of all rounds of the hypotheses and of what follows."""
    rounds = sum(fit_cost(spec, budget.effort, budget.pixel_share) for spec in specs for budget in ROUNDS)
    return rounds + expected_cost(specs[-1])


def _supported(fits: FitSequence[FitT, RefinementT], specs: Sequence[ModelSpec]) -> list[ModelSpec]:
    """What the solver fits of these models; `ConfigError` where that is nothing."""
    found = [spec for each in specs if (spec := fits.solver.supported(each)) is not None]
    if not found:
        names = " or ".join(repr(spec.name) for spec in specs)
        raise ConfigError(
            f"the reflectance renderer does not fit {names}; choose another reflectance.renderer or model"
        )
    return found


def _default(fits: FitSequence[FitT, RefinementT], settings: ReflectanceSettings) -> ModelSpec:
    """The model that is fitted without a comparison; the simplest hypothesis where the solver does not fit it."""
    return fits.solver.supported(default_spec(settings)) or _supported(fits, hypotheses(settings))[0]


def _decide(
    fits: FoldedFits[FitT, RefinementT],
    halving: SuccessiveHalving[FitT, RefinementT],
    finalists: Sequence[Contestant[FitT]],
) -> tuple[Contestant[FitT], dict[ModelSpec, FoldedFit[FitT]]]:
    """The simplest of the finalists that tie with the best one, and the fits of those on the views of all folds.

    Near ties are fitted on the other folds, too; but not where the simplest hypothesis is a special case of all that
    tie with it: it is selected in any case, and the others are compared again with the same refinements.
    """
    tied = _tied(fits, finalists, {each.spec: each.last for each in finalists})
    simplest = min(tied, key=lambda each: complexity(each.spec))
    pooled: dict[ModelSpec, FoldedFit[FitT]] = {}
    rivals = [each for each in tied if each is not simplest and not contains(each.spec, simplest.spec)]
    if rivals and len(fits.further):
        fits.expect(2 * sum(halving.cost(each.spec) for each in tied) + expected_cost(simplest.spec))
        for each in tied:
            fit = None
            for budget in ROUNDS:
                fit = halving.fit_round(each.spec, fit, budget, fits.further)
            assert fit is not None
            pooled[each.spec] = on_more_views(each.last, fit)
        tied = _tied(fits, tied, pooled)
    return min(tied, key=lambda each: complexity(each.spec)), pooled


def _tied(
    fits: FoldedFits[FitT, RefinementT],
    contestants: Sequence[Contestant[FitT]],
    last: Mapping[ModelSpec, FoldedFit[FitT]],
) -> list[Contestant[FitT]]:
    """Those than which none under the best light is better, the best one among them, and those that need no
    improvement.
    """
    compared = [last[each.spec] for each in contestants]
    light = max(compared, key=lambda fit: mean_decibels(fit.errors_between_lights)).spec.light
    under_it = [fit for fit in compared if fit.spec.light == light]
    return [
        each
        for each in contestants
        if last[each.spec].held_out_db >= SUFFICIENT_DB
        or not any(fits.is_better(fit, than=last[each.spec]) for fit in under_it)
    ]


def _margin(
    winner: Contestant[FitT], other: Contestant[FitT], fairest_first: Sequence[Mapping[ModelSpec, FoldedFit[FitT]]]
) -> tuple[float, float, int]:
    """Margin of the winner, its standard error and the number of views, from the last fits that both have."""
    for fits in fairest_first:
        if winner.spec in fits and other.spec in fits:
            before, after = fits[other.spec], fits[winner.spec]
            break
    else:
        before, after = other.last, winner.rounds[len(other.rounds) - 1]
    return *gain_of(after, over=before), len(before.errors)


def _fit_single_model(fits: FitSequence[FitT, RefinementT], spec: ModelSpec, views: Sequence[int]) -> FitT:
    """The fit of one model to all views; the lobe before the normals, which would imitate it."""
    plan = [replace(spec, normals="mesh"), spec] if spec.normals == "map" else [spec]
    fits.expect(sum(fit_cost(each, 1.0) for each in plan))
    fit = None
    for each in plan:
        fit = fits.fit(each, fit, views, 1.0)
    assert fit is not None
    return fit
