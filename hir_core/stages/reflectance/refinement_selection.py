"""Refinements of one explanation: maps, shading normals, per-texel BRDF; each accepted while held-out views gain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, final

from hir_core.plugins.interfaces import FitT, RefinementT
from hir_core.plugins.model_spec import ModelSpec
from hir_core.stages.reflectance.fit_sequence import fit_cost
from hir_core.stages.reflectance.folded_fits import FoldedFit, FoldedFits
from hir_core.stages.reflectance.held_out_comparison import (
    REQUIRED_STANDARD_ERRORS,
    SUFFICIENT_DB,
    differs,
    is_significant,
    paired_gain,
)
from hir_core.stages.reflectance.successive_halving import Budget

REQUIRED_STANDARD_ERRORS_OF_NORMALS = 2.0
"""Two more values for each vertex can imitate much: on three views of a smooth ball under a sun, normals gained
3.1 ± 2.7 dB. Six more values for each texel can imitate more, so this holds for the per-texel BRDF too."""
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

    def refine_vertices(self) -> None:
        """Compares everything that is fitted at vertices."""
        if self.spec.bounces:
            self._compare(replace(self.spec, bounces=0), simpler=True)
        if self.spec.kind == "paper":
            self._compare(replace(self.spec, colored=True))
        if self.spec.kind in ("paper", "dielectric"):
            self._compare(replace(self.spec, specular="map"))
        if self.spec.kind != "diffuse":
            self._compare(replace(self.spec, roughness="map"))
        if self.spec.light_frame == "world":
            self._compare(
                replace(self.spec, normals="map"), required_standard_errors=REQUIRED_STANDARD_ERRORS_OF_NORMALS
            )

    def question(self, rival: FoldedFit[FitT], simpler: bool) -> FoldedFit[FitT]:
        """Gives a rival the refinements and the effort of the selected model, and selects it where it is better.

        A `simpler` rival is selected in a tie, too. Returns the fit of the rival.
        """
        spec = self._fits.supported(with_refinements(rival.spec, self.spec)) or rival.spec
        fit = self._fits.fit(spec, rival, self.effort, COMPARISON.pixel_share)
        self._fitted(fit)
        gain, standard_error = paired_gain(self.fit.errors, fit.errors)
        views = len(fit.errors)
        worse, better = differs(-gain, standard_error, views), differs(gain, standard_error, views)
        accepted = better or (simpler and not worse)
        if accepted:
            self.fit, self._has_control = fit, False
        self._record(fit, gain, standard_error, accepted)
        return fit

    def compare_per_texel(self) -> None:
        """Selects the per-texel BRDF where held-out views gain over a per-texel albedo; neither continues the fit.

        Where maps at vertices were accepted, vertices are fine enough for what varies.
        """
        if self.spec.light_frame != "world" or self.spec.kind == "diffuse" or self.spec.mapped:
            return
        if self.fit.held_out_db >= SUFFICIENT_DB or not self._is_supported(replace(self.spec, per_texel="brdf")):
            return
        control, candidate = (
            self._fits.fit(replace(self.spec, per_texel=each), self.fit, 0.0, cost_effort=COMPARISON.effort)  # type: ignore[arg-type]
            for each in ("albedo", "brdf")
        )
        gain, standard_error = paired_gain(control.errors, candidate.errors)
        accepted = is_significant(gain, standard_error, len(control.errors), REQUIRED_STANDARD_ERRORS_OF_NORMALS)
        if accepted:
            self.fit = candidate
        self._record(candidate, gain, standard_error, accepted)

    def _compare(
        self, spec: ModelSpec, simpler: bool = False, required_standard_errors: float = REQUIRED_STANDARD_ERRORS
    ) -> None:
        """Selects a candidate that gains significantly; a `simpler` one unless the control gains on it.

        Nothing is added to a fit that needs no improvement, and nothing is compared that the solver does not fit.
        """
        if (not simpler and self.fit.held_out_db >= SUFFICIENT_DB) or not self._is_supported(spec):
            return
        if not self._has_control:
            # more steps alone lower the error: without this control every candidate would seem to gain
            self._initial, self._has_control = self.fit, True
            self.fit = self._continued(self.spec)
            self.effort += COMPARISON.effort
        fit = self._continued(spec)
        gain, standard_error = paired_gain(self.fit.errors, fit.errors)
        views = len(fit.errors)
        if simpler:
            accepted = not is_significant(-gain, standard_error, views, required_standard_errors)
        else:
            accepted = is_significant(gain, standard_error, views, required_standard_errors)
        if accepted:
            self.fit, self._has_control = fit, False
        self._record(fit, gain, standard_error, accepted)

    def _is_supported(self, spec: ModelSpec) -> bool:
        """Whether the solver fits this very model."""
        return self._fits.supported(spec) == spec

    def _continued(self, spec: ModelSpec) -> FoldedFit[FitT]:
        fit = self._fits.fit(spec, self._initial, COMPARISON.effort, COMPARISON.pixel_share)
        self._fitted(fit)
        return fit

    def _record(self, fit: FoldedFit[FitT], gain: float, standard_error: float, accepted: bool) -> None:
        self.comparisons.append(Comparison(fit.spec, fit.held_out_db, gain, standard_error, accepted))
        self._compared(self.comparisons[-1])


def with_refinements(spec: ModelSpec, of: ModelSpec) -> ModelSpec:
    """A hypothesis with the freedom of another model: its maps, and a specular map against a map of metalness."""
    specular = spec.kind != "diffuse"
    maps_specular = spec.kind in ("paper", "dielectric") and (of.specular == "map" or of.kind == "mixed")
    return replace(
        spec,
        bounces=of.bounces if spec.light_frame == "world" and of.light_frame == "world" else spec.bounces,
        specular="map" if maps_specular else spec.specular,
        colored=of.colored and spec.kind == "paper",
        roughness=of.roughness if specular else "uniform",
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
