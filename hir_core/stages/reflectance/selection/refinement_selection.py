"""Refinements of one explanation: maps, shading normals, per-texel BRDF; each accepted while held-out views gain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Generic, final

import numpy as np

from hir_core.plugins.interfaces import FitT, RefinementT
from hir_core.plugins.model_spec import ModelSpec
from hir_core.stages.reflectance.selection.exposure_selection import (
    ExposureSelection,
    at_own_exposures,
    exposures_are_confirmed,
    exposures_may_differ,
)
from hir_core.stages.reflectance.selection.fit_sequence import fit_cost
from hir_core.stages.reflectance.selection.folded_fits import FoldedFit, FoldedFits, gain_of, on_more_views
from hir_core.stages.reflectance.selection.held_out_comparison import (
    REQUIRED_STANDARD_ERRORS,
    SMALLEST_ERROR,
    SUFFICIENT_DB,
    differs,
    is_near_tie,
    is_refined,
    paired_gain,
)
from hir_core.stages.reflectance.selection.successive_halving import ROUNDS, Budget

REQUIRED_STANDARD_ERRORS_OF_NORMALS = 2.0
"""Two more values for each vertex can imitate much: on three views of a smooth ball under a sun, normals gained
3.1 ± 2.7 dB. Six more values for each texel can imitate more, so this holds for the per-texel BRDF too."""
MIN_GAIN_OF_ROUGHNESS_MAP_DB = 0.3
"""Held-out views stand under the light of the fit, and a map of the roughness can imitate what is wrong with that
light. Maps that gained less there gain nothing on unseen and relit views (docs/studies/lobe_width.md)."""
COMPARISON = Budget(0.3, 0.3)
"""What each candidate and its control get."""


@dataclass(frozen=True)
class Comparison:
    """One candidate, compared with the model that was selected before it."""

    spec: ModelSpec
    held_out_db: float
    gain_db: float
    """Mean over held-out views, against the model that was selected before."""
    standard_error_db: float
    """Of `gain_db`."""
    held_out_views: int
    accepted: bool


@final
class RefinementSelection(Generic[FitT, RefinementT]):
    """The best fit so far. Each comparison fits candidates and, as a control, the selected model for as many steps.

    One control serves all comparisons until a candidate is accepted: all continue from the same fit.
    """

    def __init__(
        self,
        fits: FoldedFits[FitT, RefinementT],
        first: FoldedFit[FitT],
        fitted: Callable[[FoldedFit[FitT]], None],
        compared: Callable[[Comparison], None],
    ) -> None:
        """`first`: the fit of the hypothesis; `fitted` and `compared` receive each fit and comparison."""
        self._fits, self._fitted, self._compared = fits, fitted, compared
        self._initial = self.fit = first
        self._has_control = False
        self.effort = 0.0
        """Effort that was spent on the selected fit since `first`."""
        self.comparisons: list[Comparison] = []

    @property
    def spec(self) -> ModelSpec:
        """The selected model."""
        return self.fit.spec

    def compare_exposures_again(self, selection: ExposureSelection, differ: bool = False) -> ExposureSelection:
        """Selects simpler exposures unless fitted ones gain, with every held-out view at an exposure of its own.

        Where colours of the same places `differ` between photographs, fitted ones stay unless they lose, as before the
        hypotheses.
        """
        candidate, _, _ = self._against_control(replace(self.spec, exposures=selection.before))
        own = at_own_exposures(self._fits, candidate)
        gain, standard_error = paired_gain(own.errors, self.fit.errors)
        needed = exposures_are_confirmed(own, self.fit, self._fits, differ)
        self._record(replace(own, spec=candidate.spec), -gain, standard_error, accepted=not needed)
        if not needed:
            self.fit, self._has_control = candidate, False
        return ExposureSelection(self.spec.exposures, selection.before, gain, standard_error, len(own.errors))

    def compare_exposures(self, selection: ExposureSelection, differ: bool = False) -> ExposureSelection:
        """Selects fitted exposures where held-out views gain, all at exposures of their own; `differ` as above.

        Nothing is fitted where held-out views are as near at the exposures of the model.
        """
        if not self._is_worth_comparing(replace(self.spec, exposures="fitted")):
            return selection
        if not exposures_may_differ(self.fit, at_own_exposures(self._fits, self.fit)):
            return selection
        candidate, _, _ = self._against_control(replace(self.spec, exposures="fitted"))
        control = at_own_exposures(self._fits, self.fit)
        gain = paired_gain(control.errors, candidate.errors)
        accepted = exposures_are_confirmed(control, candidate, self._fits, differ)
        if accepted:
            self.fit, self._has_control = candidate, False
        self._record(candidate, *gain, accepted=accepted)
        return ExposureSelection(self.spec.exposures, selection.exposures, *gain, len(control.errors))

    def refine_vertices(self) -> None:
        """Compares everything that is fitted at vertices."""
        if self.spec.bounces:
            self._compare(replace(self.spec, bounces=0), simpler=True)
        while self._accept_best(lobe_refinements(self.spec)):
            pass
        if self.spec.light_frame == "world":
            self._compare(
                replace(self.spec, normals="map"), required_standard_errors=REQUIRED_STANDARD_ERRORS_OF_NORMALS
            )

    def compare_runner_up(self, rival: FoldedFit[FitT], simpler: bool) -> FoldedFit[FitT]:
        """Gives a rival the refinements and the effort of the selected model, and selects it where it is better.

        A `simpler` rival is selected in a tie, too; one under another, less simple light not in a near tie. Shading
        normals are fitted under a light in the world alone, so such a rival of a light on the camera gets them where
        they gain. Returns the fit of the rival.
        """
        spec = self._fits.supported(with_refinements(rival.spec, self.spec)) or rival.spec
        relief = replace(spec, normals="map")
        has_relief = (self.spec.light_frame, spec.light_frame) == ("camera", "world") and self._is_supported(relief)
        if has_relief:
            self._with_control([])
        fit = self._fits.fit(spec, rival, self.effort, COMPARISON.pixel_share)
        self._fitted(fit)
        if has_relief:
            candidate = self._fits.fit(relief, rival, self.effort, COMPARISON.pixel_share)
            self._fitted(candidate)
            if is_refined(fit.errors, candidate.errors, REQUIRED_STANDARD_ERRORS_OF_NORMALS):
                fit = candidate
        gain, standard_error = gain_of(fit, over=self.fit)
        views = len(fit.errors)
        if simpler:
            accepted = not self._fits.is_better(self.fit, than=fit)
        elif spec.light_frame != self.spec.light_frame:
            # the simpler light stays in a near tie: a wrong one spoils every relit picture
            accepted = not is_near_tie(gain, standard_error, views)
        else:
            accepted = self._fits.is_better(fit, than=self.fit)
        if accepted:
            self.fit, self._has_control = fit, False
        self._record(fit, gain, standard_error, accepted)
        return fit

    def compare_per_texel(self) -> None:
        """Selects the per-texel BRDF where held-out views gain over a per-texel albedo; neither continues the fit.

        A gain between one and two standard errors is measured again with the views of the other folds.

        It is not selected where it is behind the model that it would replace: both may share a limit of texels, such as
        the width of the narrowest lobe. Where maps of the lobe at vertices were accepted, vertices are fine enough for
        what varies. A normal map says nothing about that; each texel then has its own normal in its place.
        """
        lobe_maps = "map" in (self.spec.specular, self.spec.roughness, self.spec.metalness)
        if self.spec.light_frame != "world" or self.spec.kind == "diffuse" or lobe_maps:
            return
        if not self._is_worth_comparing(replace(self.spec, normals="mesh", per_texel="brdf")):
            return
        control, candidate = self._per_texel(self.fit)
        judged, views = candidate, len(candidate.errors)
        gain, standard_error = paired_gain(control.errors, candidate.errors)
        accepted = is_refined(control.errors, candidate.errors, REQUIRED_STANDARD_ERRORS_OF_NORMALS)
        change, error_of_change = paired_gain(self.fit.errors, candidate.errors)
        if differs(-change, error_of_change, views):
            gain, standard_error, accepted = change, error_of_change, False
        elif not accepted and is_refined(control.errors, candidate.errors) and len(self._fits.further):
            control, judged = self._per_texel_on_more_views(control, candidate)
            gain, standard_error = paired_gain(control.errors, judged.errors)
            accepted = is_refined(control.errors, judged.errors, REQUIRED_STANDARD_ERRORS_OF_NORMALS)
        if accepted:
            self.fit = candidate
        self._record(judged, gain, standard_error, accepted)

    def _per_texel_on_more_views(
        self, control: FoldedFit[FitT], candidate: FoldedFit[FitT]
    ) -> tuple[FoldedFit[FitT], FoldedFit[FitT]]:
        """Control and candidate on the views of all folds: few views may not tell a gain from noise."""
        spec, more = replace(self.spec, normals="mesh"), self._fits.further
        at_vertices = sum(fit_cost(spec, each.effort, each.pixel_share) for each in ROUNDS)
        self._fits.expect(at_vertices + 2 * fit_cost(spec, COMPARISON.effort))
        fit = None
        for budget in ROUNDS:
            fit = self._fits.fit(spec, fit, budget.effort, budget.pixel_share, folds=more)
        assert fit is not None
        albedo, brdf = self._per_texel(fit, more)
        return on_more_views(control, albedo), on_more_views(candidate, brdf)

    def compare_per_texel_of_rival(self, rival: FoldedFit[FitT]) -> FoldedFit[FitT] | None:
        """Selects the per-texel BRDF of a rival under a light in the world, in place of a light on the camera.

        A light on the camera has no per-texel BRDF, and its fit at vertices is not comparable with values of texels.
        What the BRDF gains over a per-texel albedo is therefore compared with what the rival lacks at vertices. Returns
        the rival with its errors at vertices lowered by the gain, where it was selected.
        """
        spec = replace(rival.spec, normals="mesh", per_texel="brdf")
        if rival.spec.light_frame != "world" or rival.spec.kind == "diffuse" or not self._is_worth_comparing(spec):
            return None
        control, candidate = self._per_texel(rival)
        lowered = candidate.errors / np.maximum(control.errors, SMALLEST_ERROR)
        errors, between_lights = rival.errors * lowered, rival.errors_between_lights * lowered
        at_vertices = replace(rival, errors=errors, errors_between_lights=between_lights)
        before, after = self.fit.errors_beside(rival.spec), at_vertices.errors_beside(self.spec)
        accepted = is_refined(before, after, REQUIRED_STANDARD_ERRORS_OF_NORMALS)
        if accepted:
            self.fit = candidate
        self._record(candidate, *paired_gain(before, after), accepted)
        return at_vertices if accepted else None

    def _per_texel(self, fit: FoldedFit[FitT], folds: range | None = None) -> tuple[FoldedFit[FitT], FoldedFit[FitT]]:
        """A fit at vertices with a per-texel albedo, and with a per-texel BRDF."""
        albedo, brdf = (
            self._fits.fit(spec, fit, 0.0, cost_effort=COMPARISON.effort, folds=folds)
            for spec in (
                replace(fit.spec, normals="mesh", per_texel="albedo"),
                replace(fit.spec, normals="mesh", per_texel="brdf"),
            )
        )
        return albedo, brdf

    def _compare(
        self, spec: ModelSpec, simpler: bool = False, required_standard_errors: float = REQUIRED_STANDARD_ERRORS
    ) -> None:
        """Selects a candidate that gains significantly; a `simpler` one unless the control gains on it."""
        if not self._is_worth_comparing(spec, simpler):
            return
        fit, gain, standard_error = self._against_control(spec)
        if simpler:
            accepted = not is_refined(fit.errors, self.fit.errors, required_standard_errors)
        else:
            accepted = is_refined(self.fit.errors, fit.errors, required_standard_errors)
        if accepted:
            self.fit, self._has_control = fit, False
        self._record(fit, gain, standard_error, accepted)

    def _accept_best(self, specs: Sequence[ModelSpec]) -> bool:
        """Selects the candidate with the largest gain if that is significant. Whether one was selected.

        All continue from the same fit. One after the other, a map that imitates what a later one explains would be
        selected because its turn comes first.
        """
        compared = self._all_against_control([spec for spec in specs if self._is_worth_comparing(spec)])
        gaining = [each for each in compared if self._gains_enough(each[0], each[1])]
        best = max(gaining, key=lambda each: each[1], default=None)
        for each in compared:
            self._record(*each, accepted=each is best)
        if best is not None:
            self.fit, self._has_control = best[0], False
        return best is not None

    def _gains_enough(self, fit: FoldedFit[FitT], gain: float) -> bool:
        """Whether one more map or colour in the lobe is accepted for its gain."""
        adds_roughness = fit.spec.roughness == "map" and self.spec.roughness != "map"
        if adds_roughness and gain < MIN_GAIN_OF_ROUGHNESS_MAP_DB:
            return False
        return is_refined(self.fit.errors, fit.errors)

    def _is_worth_comparing(self, spec: ModelSpec, simpler: bool = False) -> bool:
        """Nothing is added to a fit that needs no improvement, and nothing is compared that the solver does not fit."""
        return (simpler or self.fit.held_out_db < SUFFICIENT_DB) and self._is_supported(spec)

    def _against_control(self, spec: ModelSpec) -> tuple[FoldedFit[FitT], float, float]:
        """The fit of a candidate, its gain over the control and the standard error of that."""
        return self._all_against_control([spec])[0]

    def _all_against_control(self, specs: Sequence[ModelSpec]) -> list[tuple[FoldedFit[FitT], float, float]]:
        """The same of several candidates, which all continue from the fit that the control continues."""
        if not specs:
            return []
        fits = self._with_control(specs)
        return [(fit, *paired_gain(self.fit.errors, fit.errors)) for fit in fits]

    def _with_control(self, specs: Sequence[ModelSpec]) -> list[FoldedFit[FitT]]:
        """Fits of candidates. Where the selected fit was not continued since it was selected, it is continued beside
        them. More steps alone lower the error: without this control every candidate would seem to gain.
        """
        missing = [] if self._has_control else [self.spec]
        if missing:
            self._initial, self._has_control = self.fit, True
            self.effort += COMPARISON.effort
        budget = COMPARISON.effort, COMPARISON.pixel_share
        fits = self._fits.side_by_side([*missing, *specs], self._initial, *budget, self._fitted)
        if missing:
            self.fit, *fits = fits
        return fits

    def _is_supported(self, spec: ModelSpec) -> bool:
        """Whether the solver fits this very model."""
        return self._fits.supported(spec) == spec

    def _record(self, fit: FoldedFit[FitT], gain: float, standard_error: float, accepted: bool) -> None:
        self.comparisons.append(Comparison(fit.spec, fit.held_out_db, gain, standard_error, len(fit.errors), accepted))
        self._compared(self.comparisons[-1])


def lobe_refinements(spec: ModelSpec) -> list[ModelSpec]:
    """The models with one more map or colour in the specular lobe."""
    found = []
    if spec.kind == "paper" and not spec.colored:
        found.append(replace(spec, colored=True))
    if spec.kind in ("paper", "dielectric") and spec.specular != "map":
        found.append(replace(spec, specular="map"))
    if spec.kind != "diffuse" and spec.roughness != "map":
        found.append(replace(spec, roughness="map"))
    return found


def with_refinements(spec: ModelSpec, of: ModelSpec) -> ModelSpec:
    """A hypothesis with the freedom of another model: its maps. Against a map of metalness a dielectric gets a map of
    the specular albedo, and a metal one of the roughness.
    """
    maps_specular = spec.kind in ("paper", "dielectric") and (of.specular == "map" or of.kind == "mixed")
    maps_metal = spec.kind == "metal" and of.kind == "mixed"
    maps_roughness = spec.kind != "diffuse" and (of.roughness == "map" or maps_metal)
    return replace(
        spec,
        exposures=of.exposures,
        bounces=of.bounces if spec.light_frame == "world" and of.light_frame == "world" else spec.bounces,
        specular="map" if maps_specular else spec.specular,
        colored=of.colored and spec.kind == "paper",
        roughness="map" if maps_roughness else "uniform",
        normals=of.normals if spec.light_frame == "world" else "mesh",
    )


def expected_cost(spec: ModelSpec) -> float:
    """Of the comparisons of a hypothesis that accepts no refinement."""
    effort, share = COMPARISON.effort, COMPARISON.pixel_share
    fitted = 1 + bool(spec.bounces) + (spec.kind in ("paper", "dielectric")) + (spec.kind != "diffuse")
    cost = fitted * fit_cost(spec, effort, share)
    if spec.light_frame == "world":
        cost += fit_cost(replace(spec, normals="map"), effort, share)
        if spec.kind != "diffuse" and not spec.mapped:
            cost += 2 * fit_cost(spec, effort)
    return cost


def runner_up_cost(spec: ModelSpec) -> float:
    """Of a rival that is compared again after a selection that accepts one refinement."""
    return fit_cost(spec, 2 * COMPARISON.effort, COMPARISON.pixel_share)
