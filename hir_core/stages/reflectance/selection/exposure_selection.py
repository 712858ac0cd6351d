"""Whether photographs have one exposure, the recorded ones, or fitted ones: decided on held-out views before materials.

Small differences show only beside the selected material; they are a refinement of it. A held-out photograph has no
fitted exposure. So that fits with fitted exposures have no advantage, fits without are compared with them at exposures
that suit each held-out photograph best, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic

from hir_core.capture import Capture
from hir_core.capture.photograph_exposures import Exposures, check_recorded_exposures
from hir_core.config import ReflectanceSettings
from hir_core.errors import ConfigError
from hir_core.mesh.exposure_differences import exposure_corrections
from hir_core.plugins.interfaces import FitT, RefinementT
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import Mesh
from hir_core.stages.reflectance.selection.fit_sequence import fit_cost
from hir_core.stages.reflectance.selection.folded_fits import FoldedFit, FoldedFits
from hir_core.stages.reflectance.selection.held_out_comparison import MIN_GAIN_DB, is_significant, paired_gain
from hir_core.stages.reflectance.selection.successive_halving import ROUNDS

REQUIRED_STANDARD_ERRORS_OF_EXPOSURES = 2.0
"""Three more numbers for each photograph can imitate much, such as reflections that a simple model lacks."""
LEAST_DEVIATION_STOPS = 0.05
"""Standard deviation of fitted exposures over photographs, in the channel where it is largest, below which exposures
count as equal: fitted ones are 0.03 stops off the true ones (docs/studies/exposures.md#equal-photographs)."""
MIN_GAIN_OF_SMOOTH_EXPOSURES_DB = 0.3
"""On held-out views, of fitted exposures that change smoothly from camera to camera. Equal photographs gain up to
0.19 dB by them, and photographs whose exposures change so by up to half a stop 0.24 to 2.8 dB
(docs/studies/exposures.md#exposures-that-change-smoothly)."""
BUDGET = ROUNDS[0]
"""What each fit gets; those with equal exposures are the first fits of the rounds."""


@dataclass(frozen=True)
class ExposureSelection:
    """The exposures that were selected, and the comparison with the simpler ones."""

    exposures: Exposures
    before: Exposures = "equal"
    """What they were compared with."""
    gain_db: float | None = None
    """Mean over held-out views; None where nothing was compared."""
    standard_error_db: float | None = None
    held_out_views: int | None = None


def select_exposures(
    fits: FoldedFits[FitT, RefinementT],
    hypotheses: Sequence[ModelSpec],
    recorded: bool,
    later_cost: float = 0.0,
    differ: bool = False,
) -> ExposureSelection:
    """Compares exposures with the simplest hypothesis under each light; `recorded`: whether photographs record any.

    Exposures are fitted only where held-out views are nearer at exposures of their own, or where colours of the same
    places `differ` between photographs: then held-out views must not lose. `later_cost`: expected cost of what follows,
    for the progress.
    """
    specs = simplest_under_each_light(hypotheses)
    fits.expect(2 * len(specs) * fit_cost(specs[0], BUDGET.effort, BUDGET.pixel_share) + later_cost)
    comparison = _ExposureComparison(fits, specs, differ)
    if recorded:
        comparison.compare_recorded()
    comparison.compare_fitted()
    return comparison.selected


class _ExposureComparison(Generic[FitT, RefinementT]):
    """The best fit so far, with the exposures that were selected."""

    def __init__(self, fits: FoldedFits[FitT, RefinementT], specs: Sequence[ModelSpec], differ: bool) -> None:
        self._fits, self._specs, self._differ = fits, specs, differ
        self.selected = ExposureSelection("equal")
        self._best = self._best_with("equal")

    def compare_recorded(self) -> None:
        """Selects the recorded exposures where held-out views gain."""
        self._decide("recorded", self._best)

    def compare_fitted(self) -> None:
        """Selects fitted exposures where held-out views gain, all at exposures of their own."""
        control = at_own_exposures(self._fits, self._best)
        # the gain differs from view to view by nature, so its standard error says little
        differ = self._differ and self.selected.exposures == "equal"
        if differ or paired_gain(self._best.errors, control.errors)[0] >= MIN_GAIN_DB:
            self._decide("fitted", control, differ)

    def _decide(self, exposures: Exposures, control: FoldedFit[FitT], differ: bool = False) -> None:
        candidate = self._best_with(exposures)
        before, gain = self.selected.exposures, paired_gain(control.errors, candidate.errors)
        accepted = exposures_are_confirmed(control, candidate, self._fits, differ)
        self.selected = ExposureSelection(exposures if accepted else before, before, *gain, len(control.errors))
        if accepted:
            self._best = candidate

    def _best_with(self, exposures: Exposures) -> FoldedFit[FitT]:
        specs = [replace(spec, exposures=exposures) for spec in self._specs]
        found = self._fits.side_by_side(specs, None, BUDGET.effort, BUDGET.pixel_share)
        return max(found, key=lambda fit: fit.held_out_db)


def exposures_to_compare(
    capture: Capture, settings: ReflectanceSettings, renderer: str, is_supported: bool
) -> Sequence[Exposures]:
    """The exposures that the settings admit, the simplest first; one where nothing is to be compared.

    `is_supported`: whether the solver of the renderer fits exposures. `capture` has the recorded ones.
    """
    recorded = all(view.recorded_exposure is not None for view in capture.views)
    if settings.exposures == "auto":
        if not is_supported:
            return ("equal",)
        return ("equal", "recorded", "fitted") if recorded else ("equal", "fitted")
    if settings.exposures != "equal" and not is_supported:
        raise ConfigError(
            f"reflectance.exposures is {settings.exposures!r}, which the fit of {renderer!r} does not support; choose "
            "another reflectance.renderer, reflectance.method=auto or reflectance.exposures=equal"
        )
    if settings.exposures == "recorded":
        check_recorded_exposures(capture)
    return (settings.exposures,)


def exposures_differ(mesh: Mesh, capture: Capture) -> bool:
    """Whether photographs show the same places of the mesh in different brightness or white balance."""
    positions, normals, faces = (each.detach().cpu().numpy() for each in (mesh.positions, mesh.normals, mesh.faces))
    return exposure_corrections(positions, normals, faces, capture) is not None


def at_own_exposures(fits: FoldedFits[FitT, RefinementT], fit: FoldedFit[FitT]) -> FoldedFit[FitT]:
    """The same fit, each held-out view compared at the exposure and white balance that suit it best."""
    return fits.fit(replace(fit.spec, exposures="fitted"), fit, 0.0)


def exposures_may_differ(fit: FoldedFit[FitT], own: FoldedFit[FitT]) -> bool:
    """Whether held-out views are nearer at exposures of their own, by one standard error; else no fit is worth it."""
    return is_significant(*paired_gain(fit.errors, own.errors), len(own.errors))


def exposures_are_confirmed(
    before: FoldedFit[FitT], after: FoldedFit[FitT], fits: FoldedFits[FitT, RefinementT], differ: bool = False
) -> bool:
    """Whether held-out views confirm the exposures of `after`: they gain so much that exposures explain it, and fitted
    exposures differ by more than they are off.

    Where they change smoothly from camera to camera, as reflections of a metal do, they must gain
    `MIN_GAIN_OF_SMOOTH_EXPOSURES_DB`; those of an automatic camera change in steps, too. Where colours of the same
    places `differ` between photographs, it is enough that held-out views do not lose: a model that explains too little
    shows no gain, and the colours are evidence that does not depend on it.
    """
    gain, standard_error = paired_gain(before.errors, after.errors)
    if differ:
        return not is_significant(-gain, standard_error, len(after.errors))
    if _are_equal(fits.exposure_deviation(after)):
        return False
    is_smooth = _are_equal(fits.exposure_deviation(after, smooth_part=False))
    if is_smooth and gain < MIN_GAIN_OF_SMOOTH_EXPOSURES_DB:
        return False
    return is_significant(gain, standard_error, len(after.errors), REQUIRED_STANDARD_ERRORS_OF_EXPOSURES)


def _are_equal(deviation: float | None) -> bool:
    return deviation is not None and deviation < LEAST_DEVIATION_STOPS


def simplest_under_each_light(hypotheses: Sequence[ModelSpec]) -> list[ModelSpec]:
    """The first hypothesis under each light."""
    found: dict[str, ModelSpec] = {}
    for spec in hypotheses:
        found.setdefault(spec.light, spec)
    return list(found.values())
