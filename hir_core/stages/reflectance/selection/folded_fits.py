"""Fits of one model to the training views of each fold, judged by the held-out views of all folds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Generic, TypeVar, final

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from hir_core.capture.relative_exposures import without_reflections_of_takes
from hir_core.plugins.interfaces import FitT, RefinementT
from hir_core.plugins.model_spec import ModelSpec
from hir_core.stages.held_out_views import Fold, folds_of_a_comparison
from hir_core.stages.reflectance.selection.fit_sequence import FitSequence
from hir_core.stages.reflectance.selection.held_out_comparison import (
    is_better_hypothesis,
    is_expected_to_be_better,
    mean_decibels,
    paired_gain,
)

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class FoldedFit(Generic[FitT]):
    """One fit for each fold, and the mean squared error of every held-out view."""

    spec: ModelSpec
    fits: tuple[FitT, ...]
    errors: NDArray[np.float64]
    errors_between_lights: NDArray[np.float64]
    """`ReflectanceSolver.errors_between_lights` of every held-out view."""

    def errors_beside(self, other: ModelSpec) -> NDArray[np.float64]:
        """The errors for a comparison with another model: those between lights where its light is another."""
        return self.errors if other.light == self.spec.light else self.errors_between_lights

    @property
    def held_out_db(self) -> float:
        """Mean PSNR over held-out views."""
        return mean_decibels(self.errors)

    def without_fits(self) -> FoldedFit[FitT]:
        """The errors alone: of a fit that nothing goes on from."""
        return replace(self, fits=())


def gain_of(fit: FoldedFit[FitT], over: FoldedFit[FitT]) -> tuple[float, float]:
    """Mean gain in dB of one fit over another on the same held-out views, and its standard error."""
    return paired_gain(over.errors_beside(fit.spec), fit.errors_beside(over.spec))


def on_more_views(fit: FoldedFit[FitT], further: FoldedFit[FitT]) -> FoldedFit[FitT]:
    """The fits of one model on two sets of folds, as one."""
    return FoldedFit(
        fit.spec,
        fit.fits + further.fits,
        np.concatenate([fit.errors, further.errors]),
        np.concatenate([fit.errors_between_lights, further.errors_between_lights]),
    )


@final
class FoldedFits(Generic[FitT, RefinementT]):
    """Fits models on as many folds as give `MIN_HELD_OUT_VIEWS` judges."""

    def __init__(
        self,
        fits: FitSequence[FitT, RefinementT],
        folds: Sequence[Fold],
        camera_positions: Float[NDArray[np.floating], "views 3"] | None = None,
        takes: Sequence[int] = (),
    ) -> None:
        """`camera_positions`: around the object at the origin. `takes`: that of each view, none for one."""
        self._fits = fits
        self._folds = list(folds)
        self._camera_positions, self._takes = camera_positions, takes
        self.first = folds_of_a_comparison(folds)
        """The folds of every fit."""
        self.further = range(len(self.first), len(folds))
        """Folds that are left for near ties."""

    def fit(
        self,
        spec: ModelSpec,
        initial: FoldedFit[FitT] | None,
        effort: float,
        pixel_share: float = 1.0,
        cost_effort: float | None = None,
        folds: range | None = None,
    ) -> FoldedFit[FitT]:
        """The model fitted on each of the folds, from `initial` (of the same folds) or from its own initial guess."""
        folds = self.first if folds is None else folds
        solver = self._fits.solver
        fits, errors, between_lights = [], [], []
        for position, number in enumerate(folds):
            training, held_out = self._folds[number]
            before = initial.fits[position] if initial is not None else None
            fits.append(self._fits.fit(spec, before, training, effort, pixel_share, cost_effort))
            errors.append(solver.errors(fits[-1], held_out))
            own = solver.errors_between_lights(fits[-1], held_out)
            between_lights.append(errors[-1] if own is None else own)
        return FoldedFit(spec, tuple(fits), np.concatenate(errors), np.concatenate(between_lights))

    def exposure_deviation(self, fit: FoldedFit[FitT], smooth_part: bool = True) -> float | None:
        """How far a fit's exposures differ between photographs: standard deviation in stops, of the channel where it is
        largest, mean over the folds; None where the solver tells none.

        `smooth_part`: whether what changes smoothly from camera to camera counts; it does where no positions are known.
        """
        found = []
        for (training, _), each in zip(self._folds, fit.fits, strict=False):
            factors = self._fits.solver.exposures(each, training)
            if factors is not None and len(factors):
                stops = np.log2(np.maximum(factors, 1e-12))
                if not smooth_part:
                    stops = self._without_reflections(stops, training)
                found.append(float(stops.std(axis=0).max()))
        return float(np.mean(found)) if found else None

    def _without_reflections(self, stops: NDArray[np.float64], views: Sequence[int]) -> NDArray[np.float64]:
        if self._camera_positions is None:
            return stops
        takes = [self._takes[view] for view in views] if len(self._takes) else [0] * len(views)
        return without_reflections_of_takes(stops, self._camera_positions[list(views)], takes)

    def is_better(self, fit: FoldedFit[FitT], than: FoldedFit[FitT]) -> bool:
        """Whether a fit shows that its hypothesis is better: by held-out views or, where these gain within noise, by
        them and the training views together.
        """
        gain = gain_of(fit, over=than)
        if is_better_hypothesis(*gain, len(fit.errors)):
            return True
        if gain[0] <= 0:
            return False  # whatever a model with more freedom gains on the views that it was fitted to
        before, after = self._training_errors(than, beside=fit), self._training_errors(fit, beside=than)
        return is_expected_to_be_better(gain, paired_gain(before, after))

    def _training_errors(self, fit: FoldedFit[FitT], beside: FoldedFit[FitT]) -> NDArray[np.float64]:
        """The mean squared errors of the training views, for a comparison with another fit.

        Of a fit on further folds, too, those of the first folds alone: they share most training views with the others.
        """
        solver, found = self._fits.solver, []
        for number, each in zip(self.first, fit.fits, strict=False):
            training, _ = self._folds[number]
            errors = solver.errors_between_lights(each, training) if fit.spec.light != beside.spec.light else None
            found.append(solver.errors(each, training) if errors is None else errors)
        return np.concatenate(found)

    def in_branches(
        self, jobs: Sequence[Callable[[FoldedFits[FitT, RefinementT]], T]], ended: Callable[[T], None]
    ) -> list[T]:
        """The results of jobs that do not depend on each other, in their order: `FitSequence.in_branches`."""

        def with_fits(job: Callable[[FoldedFits[FitT, RefinementT]], T]) -> Callable[..., T]:
            return lambda fits: job(FoldedFits(fits, self._folds, self._camera_positions, self._takes))

        return self._fits.in_branches([with_fits(job) for job in jobs], ended)

    def side_by_side(
        self,
        specs: Sequence[ModelSpec],
        initial: FoldedFit[FitT] | None,
        effort: float,
        pixel_share: float,
        ended: Callable[[FoldedFit[FitT]], None] = lambda fit: None,
    ) -> list[FoldedFit[FitT]]:
        """`fit` of several models, all from the same initial fit, in branches; `ended` receives each one."""

        def fit_one(spec: ModelSpec, fits: FoldedFits[FitT, RefinementT]) -> FoldedFit[FitT]:
            return fits.fit(spec, initial, effort, pixel_share)

        return self.in_branches([partial(fit_one, spec) for spec in specs], ended)

    def fits_from_nothing(self, spec: ModelSpec) -> int:
        """Number of fits of which a fit without an initial one consists: its own and those of simpler models."""
        simpler = self._fits.solver.simpler(spec)
        return 1 if simpler is None else 1 + self.fits_from_nothing(simpler)

    def supported(self, spec: ModelSpec) -> ModelSpec | None:
        """`ReflectanceSolver.supported`."""
        return self._fits.solver.supported(spec)

    def expect(self, cost: float) -> None:
        """The cost of all fits to come, for one fold."""
        self._fits.expect(cost * len(self.first))
