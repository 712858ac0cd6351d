"""Which terms of the model a scene needs: a ladder of models, climbed while held-out views gain (DESIGN section 7).

A rung stays when the mean of its per-view gains on held-out views exceeds its standard error (times `SIGNIFICANCE`)
and `LEAST_GAIN_DB`: less than that is noise, or nothing that anybody sees; and where the rung below is as near as
`FINEST_DB`, nobody sees any gain. The gain is over the rung below it, fitted
from the same start for as many steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, Protocol, final

import numpy as np
from numpy.typing import NDArray

from hir_core.config import ReflectanceSettings
from hir_core.errors import ConfigError
from hir_core.plugins.model_spec import ModelSpec

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import ReflectanceSolver

SIGNIFICANCE = 1.0
"""The rule of one standard error (Breiman et al. 1984); with few views held out a stricter one refuses what unseen
views gain from (chair: a lobe that brings +.36 dB there, and .25 ± .21 to six held-out views)."""
NORMALS_SIGNIFICANCE = 2.0
"""Two numbers for each vertex can imitate much: three views of a smooth ball under a sun gained 3.1 ± 2.7 dB. Six more
for each texel can imitate more."""
LEAST_GAIN_DB = 0.1
FINEST_DB = 48.1
"""A root mean square error of one step of 8 bits: a fit that is nearer than that needs no further term."""
FIRST_EFFORT = 1.0
"""Share of a full fit that the first rung gets, and a light that is tried anew: both begin with one albedo for all."""
EFFORT = 0.5
"""Share of a full fit that each candidate and its control get."""
HOLD_OUT_EVERY = 8
FEWEST_HELD_OUT = 3
"""One view alone has no standard error, so that no rung above the first could ever stay."""
FEWEST_VIEWS = 6
"""With fewer views none can be spared: the ladder is not climbed and the default rung is fitted."""


@dataclass(frozen=True)
class Step:
    """One comparison on the ladder."""

    spec: ModelSpec
    held_out_db: float
    gain_db: float
    """Against the best rung before it; mean over held-out views."""
    noise_db: float
    """Standard error of that mean."""
    kept: bool

    def row(self) -> dict[str, Any]:
        """For run.json."""
        return {
            "name": self.spec.name,
            **asdict(self.spec),
            "held_out_db": round(self.held_out_db, 3),
            "gain_db": round(self.gain_db, 3),
            "noise_db": round(self.noise_db, 3),
            "kept": self.kept,
        }


class Watcher(Protocol):
    """Hears how a climb goes on."""

    def fitting(self, name: str, share: float) -> None:
        """A rung is being fitted; `share` of the course that is expected lies behind. It never falls."""

    def judged(self, held_out_db: float, training_db: float) -> None:
        """The mean dB that a fit has on the held-out views and on as many of those it was fitted to."""

    def voted(self, step: Step) -> None:
        """A candidate was kept or refused."""


def select_model(
    solver: ReflectanceSolver, settings: ReflectanceSettings, views: int, watcher: Watcher
) -> tuple[Any, ModelSpec, list[Step]]:
    """Climbs the ladder on training views, judged by held-out ones; returns the best fit and its rung.

    A rung named in the settings is fitted without a vote.
    """
    every = list(range(views))
    training, held_out = split_views(views)
    forced = forced_spec(settings)
    if forced is not None or not held_out:
        return *_without_votes(solver, forced or default_spec(settings), every, watcher), []
    ladder = _Ladder(solver, training, held_out, watcher, _expected_cost(settings))
    base = ModelSpec(light_frame=_first_frame(settings))
    ladder.begin(base)
    if settings.light_frame == "auto":
        ladder.vote([replace(base, light_frame="camera")], afresh=True)
    models = ["paper", "dielectric"] if settings.brdf == "auto" else [settings.brdf]
    ladder.vote([replace(ladder.spec, brdf=model, specular="uniform") for model in models])  # type: ignore[arg-type]
    if ladder.spec.light_frame == "world":
        # before the maps: they would paint the light between parts of the object
        before = ladder.spec
        ladder.vote([replace(ladder.spec, bounces=1)])
        if ladder.spec != before and before.brdf != "diffuse":
            # light between parts of the object can look like a lobe: with it, the lobe must prove itself again
            ladder.question(ModelSpec(bounces=1))
    if ladder.spec.brdf != "diffuse":
        ladder.vote([replace(ladder.spec, colored=True)])
        ladder.vote([replace(ladder.spec, specular="map")])
        ladder.vote([replace(ladder.spec, roughness="map")])
    if ladder.spec.light_frame == "world":
        ladder.vote([replace(ladder.spec, normals="map")], significance=NORMALS_SIGNIFICANCE)
        if ladder.spec.brdf != "diffuse" and not ladder.spec.mapped:
            # maps at vertices that were kept show that nothing changes faster than they do
            ladder.refine(replace(ladder.spec, texels="lobes"), replace(ladder.spec, texels="albedo"))
    return ladder.fit, ladder.spec, ladder.steps


def _without_votes(
    solver: ReflectanceSolver, spec: ModelSpec, views: Sequence[int], watcher: Watcher
) -> tuple[Any, ModelSpec]:
    """The fit of one rung to all views, through simpler ones where it would go astray from the start."""
    plan = []
    if spec.brdf != "diffuse":
        # a lobe that starts under a flat light widens: the ladder's first step comes first here too
        plan.append((ModelSpec(light_frame=spec.light_frame), FIRST_EFFORT))
    if spec.normals == "map":
        # and the lobe before the dents, which would do its work
        plan.append((replace(spec, normals="mesh"), FIRST_EFFORT))
    plan.append((spec, 1.0))
    course, fit = _Course(watcher, sum(_cost(*fitted) for fitted in plan)), None
    for each, effort in plan:
        fit = solver.fit(each, fit, views, effort, course.part(each, effort))
    return fit, spec


def _cost(spec: ModelSpec, effort: float) -> float:
    """About how long a fit takes, in full diffuse fits: for the progress bar alone."""
    return effort * (1 if spec.brdf == "diffuse" else 2) * (1.5 if spec.normals == "map" else 1)


def _expected_cost(settings: ReflectanceSettings) -> float:
    """Of a ladder on which a lobe and a reflection are kept and no map at vertices is."""
    matt, lobe = ModelSpec(), ModelSpec("dielectric", "uniform")
    frames = 2 if settings.light_frame == "auto" else 1
    brdfs = 2 if settings.brdf == "auto" else 1
    before = frames * _cost(matt, FIRST_EFFORT) + _cost(matt, EFFORT) + brdfs * _cost(lobe, EFFORT)
    reflection = 2 * _cost(lobe, EFFORT) + _cost(matt, EFFORT)  # it, its control, and the question after it
    maps = 4 * _cost(lobe, EFFORT) + _cost(replace(lobe, normals="map"), EFFORT)  # three, their control, and normals
    return before + reflection + maps + 2 * _cost(lobe, EFFORT)  # texels, with and without lobes


@final
class _Course:
    """How far fits have come that follow each other."""

    def __init__(self, watcher: Watcher, expected: float) -> None:
        self._watcher = watcher
        self._expected = expected
        self._spent = self._share = 0.0

    def part(self, spec: ModelSpec, effort: float) -> Callable[[float], None]:
        """What the next fit reports its own share to."""
        begins, cost = self._spent, _cost(spec, effort)
        self._spent += cost

        def tell(share: float) -> None:
            self._share = max(self._share, (begins + cost * share) / max(self._expected, self._spent))
            self._watcher.fitting(spec.name, self._share)

        return tell


class _Ladder:
    """The best fit so far; each vote pits candidates against the same rung fitted as much longer.

    That control serves every vote until one keeps its candidate: all start from the same fit and take as many steps.
    """

    def __init__(
        self,
        solver: ReflectanceSolver,
        training: Sequence[int],
        held_out: Sequence[int],
        watcher: Watcher,
        expected: float,
    ) -> None:
        self._solver = solver
        self._training = training
        self._held_out = held_out
        self._sample = training[:: max(1, len(training) // len(held_out))]
        self._watcher = watcher
        self._course = _Course(watcher, expected)
        self._errors: NDArray[np.float64] = np.empty(0)
        self._start: Any = None
        self._controlled = False
        self.fit: Any = None
        self.spec = ModelSpec()
        self.steps: list[Step] = []

    def begin(self, spec: ModelSpec) -> None:
        """Fits the first rung."""
        self.spec = spec
        self.fit, self._errors = self._fitted(spec, None, FIRST_EFFORT)
        self._record(spec, self._errors, 0.0, 0.0, True)

    def vote(self, candidates: Sequence[ModelSpec], afresh: bool = False, significance: float = SIGNIFICANCE) -> None:
        """Keeps the best candidate that held-out views prefer to the rung as it is, by `significance` errors."""
        if not afresh and not self._controlled:
            # more steps alone lower the error: without this control every rung would look like a gain
            self._start, self._controlled = self.fit, True
            self.fit, self._errors = self._fitted(self.spec, self._start, EFFORT)
        standing = self._errors
        start, effort = (None, FIRST_EFFORT) if afresh else (self._start, EFFORT)
        for spec in candidates:
            fit, errors = self._fitted(spec, start, effort)
            gain, noise = compare(standing, errors)
            better = float(decibels(errors).mean()) > float(decibels(self._errors).mean())
            told = gain > significance * noise and gain > LEAST_GAIN_DB
            kept = told and better and float(decibels(standing).mean()) < FINEST_DB
            if kept:
                self.spec, self.fit, self._errors, self._controlled = spec, fit, errors, False
            self._record(spec, errors, gain, noise, kept)

    def refine(self, finer: ModelSpec, control: ModelSpec) -> None:
        """Keeps what texels are given of their own when the rest is fitted, where held-out views prefer it to a
        `control` that is given less; neither takes another step of the fit.
        """
        fits, found = [], []
        for spec in (control, finer):
            fits.append(self._solver.fit(spec, self.fit, self._training, 0.0, self._course.part(spec, EFFORT)))
            found.append(self._solver.errors(fits[-1], self._held_out))
        standing, errors = found
        gain, noise = compare(standing, errors)
        near = float(decibels(standing).mean()) >= FINEST_DB
        kept = gain > NORMALS_SIGNIFICANCE * noise and gain > LEAST_GAIN_DB and not near
        if kept:
            self.spec, self.fit, self._errors = finer, fits[1], errors
        self._record(finer, errors, gain, noise, kept)

    def question(self, simpler: ModelSpec) -> None:
        """Goes back to a simpler rung unless what the last vote kept still gains on it; both had as many steps."""
        fit, errors = self._fitted(simpler, self._start, EFFORT)
        gain, noise = compare(errors, self._errors)
        kept = not (gain > SIGNIFICANCE * noise and gain > LEAST_GAIN_DB)
        if kept:
            self.spec, self.fit, self._errors = simpler, fit, errors
        self._record(simpler, errors, -gain, noise, kept)

    def _fitted(self, spec: ModelSpec, start: Any, effort: float) -> tuple[Any, NDArray[np.float64]]:
        fit = self._solver.fit(spec, start, self._training, effort, self._course.part(spec, effort))
        errors = self._solver.errors(fit, self._held_out)
        fitted = self._solver.errors(fit, self._sample)
        self._watcher.judged(float(decibels(errors).mean()), float(decibels(fitted).mean()))
        return fit, errors

    def _record(self, spec: ModelSpec, errors: NDArray[np.float64], gain: float, noise: float, kept: bool) -> None:
        self.steps.append(Step(spec, float(np.mean(decibels(errors))), gain, noise, kept))
        self._watcher.voted(self.steps[-1])


def split_views(views: int) -> tuple[list[int], list[int]]:
    """Numbers of the views that are fitted while models are chosen, and of those held out: none where too few."""
    every = list(range(views))
    if views < FEWEST_VIEWS:
        held_out = []
    elif views < FEWEST_HELD_OUT * HOLD_OUT_EVERY:
        held_out = [int((i + 0.5) * views / FEWEST_HELD_OUT) for i in range(FEWEST_HELD_OUT)]
    else:
        held_out = every[HOLD_OUT_EVERY // 2 :: HOLD_OUT_EVERY]
    return [v for v in every if v not in held_out], held_out


def compare(before: NDArray[np.float64], after: NDArray[np.float64]) -> tuple[float, float]:
    """Mean gain in dB over views and the standard error of that mean; paired, so easy and hard views cancel."""
    gains = decibels(after) - decibels(before)
    noise = float(gains.std(ddof=1) / np.sqrt(len(gains))) if len(gains) > 1 else float("inf")
    return float(gains.mean()), noise


def decibels(errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """PSNR of mean squared errors in a range of 1; capped at 120."""
    return np.asarray(-10 * np.log10(np.maximum(errors, 1e-12)))


def default_spec(settings: ReflectanceSettings) -> ModelSpec:
    """What is fitted when there are too few views to vote."""
    brdf = "dielectric" if settings.brdf == "auto" else settings.brdf
    return ModelSpec(brdf=brdf, specular="uniform", light_frame=_first_frame(settings))


def forced_spec(settings: ReflectanceSettings) -> ModelSpec | None:
    """The rung that `reflectance.model` names; None for `auto`."""
    if settings.model == "auto":
        return None
    brdf = "dielectric" if settings.brdf == "auto" else settings.brdf
    frame = _first_frame(settings)
    rungs = {
        "diffuse": ModelSpec(light_frame=frame),
        "specular": ModelSpec(brdf, "uniform", light_frame=frame),
        "specular_map": ModelSpec(brdf, "map", light_frame=frame),
        "roughness_map": ModelSpec(brdf, "map", "map", light_frame=frame),
        "normal_map": ModelSpec(brdf, "uniform", normals="map", light_frame=frame),
        "texel_lobes": ModelSpec(brdf, "uniform", light_frame=frame, texels="lobes"),
    }
    if settings.model in ("normal_map", "texel_lobes") and frame == "camera":
        raise ConfigError(
            f"reflectance.model={settings.model} needs a light that stands still; "
            "leave out one of it and reflectance.light_frame=camera"
        )
    return rungs[settings.model]


def _first_frame(settings: ReflectanceSettings) -> Literal["world", "camera"]:
    return "world" if settings.light_frame == "auto" else settings.light_frame
