"""Model selection: terms are added to the reflectance model while held-out views gain (DESIGN section 7).

A candidate is accepted when the mean of its per-view gains on held-out views exceeds `REQUIRED_STANDARD_ERRORS` of
that mean and `MIN_GAIN_DB`, and the selected model is not within `SUFFICIENT_DB` already. The gain is measured against
the selected model, fitted for as many steps from the same initial values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic, Protocol, final

import numpy as np
from numpy.typing import NDArray

from hir_core.config import ReflectanceSettings
from hir_core.plugins.interfaces import FitT, RefinementT
from hir_core.plugins.model_spec import ModelSpec
from hir_core.stages.held_out_views import held_out_for_model_selection
from hir_core.stages.reflectance.fit_sequence import FitSequence, fit_cost
from hir_core.stages.reflectance.held_out_comparison import REQUIRED_STANDARD_ERRORS, mean_decibels, paired_gain
from hir_core.stages.reflectance.requested_model import default_spec, forced_spec, initial_light_frame

REQUIRED_STANDARD_ERRORS_OF_NORMALS = 2.0
"""Two more values for each vertex can imitate much: on three views of a smooth ball under a sun, normals gained
3.1 ± 2.7 dB. Six more values for each texel can imitate more, so this holds for the per-texel BRDF too."""
MIN_GAIN_DB = 0.1
SUFFICIENT_DB = 48.1
"""A root mean square error of one step of 8 bits: a closer fit needs no further term."""
INITIAL_EFFORT = 1.0
"""Share of a full fit for a model that is fitted from one albedo for all vertices."""
COMPARISON_EFFORT = 0.5
"""Share of a full fit that each candidate and its control get."""


@dataclass(frozen=True)
class Comparison:
    """One candidate, compared with the model that was selected before it."""

    spec: ModelSpec
    held_out_db: float
    gain_db: float
    """Mean over held-out views, against the model that was selected before."""
    standard_error_db: float
    """Of `gain_db`."""
    accepted: bool


class SelectionObserver(Protocol):
    """Receives the intermediate results of a model selection."""

    def evaluated(self, held_out_db: float, training_db: float) -> None:
        """The mean PSNR of a fit on the held-out views, and on as many of its training views."""

    def compared(self, comparison: Comparison) -> None:
        """A candidate was accepted or rejected."""


def select_model(
    fits: FitSequence[FitT, RefinementT], settings: ReflectanceSettings, views: int, observer: SelectionObserver
) -> tuple[FitT, ModelSpec, list[Comparison]]:
    """Fits training views, decides on held-out views; returns the best fit, its model, and all comparisons.

    A model that the settings name is fitted without a comparison.
    """
    training, held_out = held_out_for_model_selection(views)
    forced = forced_spec(settings)
    if forced is not None or not held_out:
        spec = forced or default_spec(settings)
        return _fit_single_model(fits, spec, list(range(views))), spec, []
    fits.expect(_expected_cost(settings))
    selection = _ModelSelection(fits, training, held_out, observer)
    known = bool(settings.known_environment)
    base = ModelSpec(light_frame=initial_light_frame(settings), light_is_known=known)
    selection.fit_first(base)
    if settings.light_frame == "auto":
        selection.compare([replace(base, light_frame="camera")], from_scratch=True)
    brdfs = ["paper", "dielectric"] if settings.brdf == "auto" else [settings.brdf]
    selection.compare([replace(selection.spec, brdf=brdf, specular="uniform") for brdf in brdfs])  # type: ignore[arg-type]
    if selection.spec.light_frame == "world":
        # before the maps, which would absorb the light between parts of the object
        before = selection.spec
        selection.compare([replace(selection.spec, bounces=1)])
        if selection.spec != before and before.brdf != "diffuse":
            # a specular lobe can imitate indirect light: with indirect light the lobe is compared again
            selection.reconsider(ModelSpec(bounces=1, light_is_known=known))
    if selection.spec.brdf != "diffuse":
        selection.compare([replace(selection.spec, colored=True)])
        selection.compare([replace(selection.spec, specular="map")])
        selection.compare([replace(selection.spec, roughness="map")])
    if selection.spec.light_frame == "world":
        normals = replace(selection.spec, normals="map")
        selection.compare([normals], required_standard_errors=REQUIRED_STANDARD_ERRORS_OF_NORMALS)
        if selection.spec.brdf != "diffuse" and not selection.spec.mapped:
            # where maps at vertices were accepted, vertices are fine enough for what varies
            selection.compare_per_texel()
    return selection.fit, selection.spec, selection.comparisons


def _fit_single_model(fits: FitSequence[FitT, RefinementT], spec: ModelSpec, views: Sequence[int]) -> FitT:
    """The fit of one model to all views, through simpler models where a direct fit would diverge."""
    plan = []
    if spec.brdf not in ("diffuse", "metallic"):
        # a lobe that starts under a uniform light widens: the diffuse model is fitted first
        plan.append((ModelSpec(light_frame=spec.light_frame, light_is_known=spec.light_is_known), INITIAL_EFFORT))
    if spec.normals == "map":
        # the lobe before the normals, which would imitate it
        plan.append((replace(spec, normals="mesh"), INITIAL_EFFORT))
    fits.expect(sum(fit_cost(*planned) for planned in plan) + fit_cost(spec, 1.0))
    fit = None
    for simpler, effort in plan:
        fit = fits.fit(simpler, fit, views, effort)
    return fits.fit(spec, fit, views, 1.0)


def _expected_cost(settings: ReflectanceSettings) -> float:
    """Cost of a selection that accepts a lobe and indirect light, and no map at vertices."""
    matt, lobe = ModelSpec(), ModelSpec("dielectric", "uniform")
    frames = 2 if settings.light_frame == "auto" else 1
    brdfs = 2 if settings.brdf == "auto" else 1
    effort = COMPARISON_EFFORT
    before = frames * fit_cost(matt, INITIAL_EFFORT) + fit_cost(matt, effort) + brdfs * fit_cost(lobe, effort)
    indirect = 2 * fit_cost(lobe, effort) + fit_cost(matt, effort)  # candidate, its control, and the reconsidered model
    maps = 4 * fit_cost(lobe, effort) + fit_cost(replace(lobe, normals="map"), effort)  # three, their control, normals
    return before + indirect + maps + 2 * fit_cost(lobe, effort)  # per-texel BRDF and its control


@final
class _ModelSelection(Generic[FitT, RefinementT]):
    """The best fit so far. Each comparison fits candidates and, as a control, the selected model for as many steps.

    One control serves all comparisons until a candidate is accepted: all continue from the same fit.
    """

    def __init__(
        self,
        fits: FitSequence[FitT, RefinementT],
        training: Sequence[int],
        held_out: Sequence[int],
        observer: SelectionObserver,
    ) -> None:
        self._fits = fits
        self._training = training
        self._held_out = held_out
        self._training_sample = training[:: max(1, len(training) // len(held_out))]
        self._observer = observer
        self._errors: NDArray[np.float64] = np.empty(0)
        self._initial: FitT | None = None
        self._has_control = False
        self._fit: FitT | None = None
        self.spec = ModelSpec()
        self.comparisons: list[Comparison] = []

    @property
    def fit(self) -> FitT:
        """The fit of the selected model."""
        assert self._fit is not None, "fit_first comes first"
        return self._fit

    def fit_first(self, spec: ModelSpec) -> None:
        """Fits the first model."""
        self.spec = spec
        self._fit, self._errors = self._fitted(spec, None, INITIAL_EFFORT)
        self._record(spec, self._errors, 0.0, 0.0, True)

    def compare(
        self,
        candidates: Sequence[ModelSpec],
        from_scratch: bool = False,
        required_standard_errors: float = REQUIRED_STANDARD_ERRORS,
    ) -> None:
        """Selects the best candidate that gains significantly on held-out views, if any does."""
        if not from_scratch and not self._has_control:
            # more steps alone lower the error: without this control every candidate would seem to gain
            self._initial, self._has_control = self._fit, True
            self._fit, self._errors = self._fitted(self.spec, self._initial, COMPARISON_EFFORT)
        control = self._errors
        initial, effort = (None, INITIAL_EFFORT) if from_scratch else (self._initial, COMPARISON_EFFORT)
        for spec in candidates:
            fit, errors = self._fitted(spec, initial, effort)
            gain, standard_error = paired_gain(control, errors)
            best = mean_decibels(errors) > mean_decibels(self._errors)
            significant = gain > required_standard_errors * standard_error and gain > MIN_GAIN_DB
            accepted = significant and best and mean_decibels(control) < SUFFICIENT_DB
            if accepted:
                self.spec, self._fit, self._errors, self._has_control = spec, fit, errors, False
            self._record(spec, errors, gain, standard_error, accepted)

    def compare_per_texel(self) -> None:
        """Selects the per-texel BRDF where held-out views gain over a per-texel albedo; neither continues the fit."""
        spec, control = replace(self.spec, per_texel="brdf"), replace(self.spec, per_texel="albedo")
        fits, errors = [], []
        for each in (control, spec):
            fits.append(self._fits.fit(each, self._fit, self._training, 0.0, cost_effort=COMPARISON_EFFORT))
            errors.append(self._fits.solver.errors(fits[-1], self._held_out))
        gain, standard_error = paired_gain(*errors)
        significant = gain > REQUIRED_STANDARD_ERRORS_OF_NORMALS * standard_error and gain > MIN_GAIN_DB
        accepted = significant and mean_decibels(errors[0]) < SUFFICIENT_DB
        if accepted:
            self.spec, self._fit, self._errors = spec, fits[1], errors[1]
        self._record(spec, errors[1], gain, standard_error, accepted)

    def reconsider(self, simpler: ModelSpec) -> None:
        """Returns to a simpler model unless the model accepted last still gains on it; both had as many steps."""
        fit, errors = self._fitted(simpler, self._initial, COMPARISON_EFFORT)
        gain, standard_error = paired_gain(errors, self._errors)
        accepted = not (gain > REQUIRED_STANDARD_ERRORS * standard_error and gain > MIN_GAIN_DB)
        if accepted:
            self.spec, self._fit, self._errors = simpler, fit, errors
        self._record(simpler, errors, -gain, standard_error, accepted)

    def _fitted(self, spec: ModelSpec, initial: FitT | None, effort: float) -> tuple[FitT, NDArray[np.float64]]:
        fit = self._fits.fit(spec, initial, self._training, effort)
        errors = self._fits.solver.errors(fit, self._held_out)
        training_errors = self._fits.solver.errors(fit, self._training_sample)
        self._observer.evaluated(mean_decibels(errors), mean_decibels(training_errors))
        return fit, errors

    def _record(
        self, spec: ModelSpec, errors: NDArray[np.float64], gain: float, standard_error: float, accepted: bool
    ) -> None:
        self.comparisons.append(Comparison(spec, mean_decibels(errors), gain, standard_error, accepted))
        self._observer.compared(self.comparisons[-1])
