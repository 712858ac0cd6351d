"""Which terms of the model a scene needs: a ladder of models, climbed while held-out views gain (DESIGN section 7).

A rung stays when the mean of its per-view gains on held-out views exceeds `SIGNIFICANCE` standard errors of that mean
and `LEAST_GAIN_DB`: less than that is noise, or nothing that anybody sees.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from hir_core.config import ReflectanceSettings
from hir_core.errors import ConfigError

if TYPE_CHECKING:
    from hir_core.interfaces import ReflectanceSolver

SIGNIFICANCE = 2.0
LEAST_GAIN_DB = 0.05
HOLD_OUT_EVERY = 8
FEWEST_VIEWS = 6
"""With fewer views none can be spared: the ladder is not climbed and the default rung is fitted."""


@dataclass(frozen=True)
class Rung:
    """One model of the ladder."""

    brdf: Literal["diffuse", "paper", "dielectric"] = "diffuse"
    specular: Literal["none", "uniform", "map"] = "none"
    roughness: Literal["uniform", "map"] = "uniform"
    colored: bool = False
    """Is ρs a colour, as metals need, or one number?"""
    bounces: int = 0
    """Indirect light: times that light is reflected between parts of the surface."""
    light_frame: Literal["world", "camera"] = "world"

    @property
    def name(self) -> str:
        """What reports call it."""
        if self.brdf == "diffuse":
            parts = ["diffuse"]
        else:
            parts = [self.brdf, "specular map" if self.specular == "map" else "specular"]
            if self.colored:
                parts.append("coloured")
            if self.roughness == "map":
                parts.append("roughness map")
        if self.light_frame == "camera":
            parts.append("light on camera")
        if self.bounces:
            parts.append(f"{self.bounces} bounce" + "s" * (self.bounces > 1))
        return ", ".join(parts)


@dataclass(frozen=True)
class Step:
    """One comparison on the ladder."""

    rung: Rung
    held_out_db: float
    gain_db: float
    """Against the best rung before it; mean over held-out views."""
    noise_db: float
    """Standard error of that mean."""
    kept: bool
    seconds: float

    def row(self) -> dict[str, Any]:
        """For run.json: everything but the seconds, which differ from run to run."""
        return {"name": self.rung.name, **asdict(self.rung), "held_out_db": round(self.held_out_db, 3),
                "gain_db": round(self.gain_db, 3), "noise_db": round(self.noise_db, 3), "kept": self.kept}


def climb(
    solver: ReflectanceSolver, settings: ReflectanceSettings, views: int, tell: Callable[[str, float], None]
) -> tuple[Any, Rung, list[Step]]:
    """Climbs the ladder on training views, judged by held-out ones; returns the best fit and its rung.

    `tell(name of the rung, share done)` hears of progress. A rung named in the settings is fitted without a vote.
    """
    every = list(range(views))
    held_out = every[HOLD_OUT_EVERY // 2 :: HOLD_OUT_EVERY] if views >= FEWEST_VIEWS else []
    training = [v for v in every if v not in held_out]
    forced = forced_rung(settings)
    if forced is not None or not held_out:
        rung = forced or default_rung(settings)
        fit = solver.fit(rung, None, every, 1.0, lambda share: tell(rung.name, share))
        return fit, rung, []
    ladder = _Ladder(solver, training, held_out, tell)
    ladder.try_rung(Rung(light_frame=_first_frame(settings)))
    if settings.light_frame == "auto":
        ladder.try_rung(Rung(light_frame="camera"), afresh=True, effort=0.2)
    models = ["paper", "dielectric"] if settings.brdf == "auto" else [settings.brdf]
    base = ladder.rung
    for model in models:
        ladder.try_rung(replace(base, brdf=model, specular="uniform"), start=ladder.fits[base])  # type: ignore[arg-type]
    if ladder.rung.brdf != "diffuse":
        ladder.try_rung(replace(ladder.rung, colored=True))
        ladder.try_rung(replace(ladder.rung, specular="map"))
        ladder.try_rung(replace(ladder.rung, roughness="map"))
    if ladder.rung.light_frame == "world":
        ladder.try_rung(replace(ladder.rung, bounces=1))
    return ladder.fits[ladder.rung], ladder.rung, ladder.steps


class _Ladder:
    def __init__(
        self, solver: ReflectanceSolver, training: Sequence[int], held_out: Sequence[int],
        tell: Callable[[str, float], None],
    ) -> None:
        self._solver = solver
        self._training = training
        self._held_out = held_out
        self._tell = tell
        self._errors: NDArray[np.float64] = np.empty(0)
        self.fits: dict[Rung, Any] = {}
        self.rung = Rung()
        self.steps: list[Step] = []

    def try_rung(self, rung: Rung, start: Any = None, afresh: bool = False, effort: float = 0.5) -> None:
        """Fits a rung, from the best so far unless told otherwise, and keeps it when it is better."""
        began = time.perf_counter()
        first = not self.steps
        if start is None and not (first or afresh):
            start = self.fits[self.rung]
        fit = self._solver.fit(rung, start, self._training, effort, lambda share: self._tell(rung.name, share))
        errors = self._solver.errors(fit, self._held_out)
        self.fits[rung] = fit
        gain, noise = (0.0, 0.0) if first else compare(self._errors, errors)
        kept = first or (gain > SIGNIFICANCE * noise and gain > LEAST_GAIN_DB)
        if kept:
            self.rung, self._errors = rung, errors
        held_out_db = float(np.mean(decibels(errors)))
        self.steps.append(Step(rung, held_out_db, gain, noise, kept, time.perf_counter() - began))


def compare(before: NDArray[np.float64], after: NDArray[np.float64]) -> tuple[float, float]:
    """Mean gain in dB over views and the standard error of that mean; paired, so easy and hard views cancel."""
    gains = decibels(after) - decibels(before)
    noise = float(gains.std(ddof=1) / np.sqrt(len(gains))) if len(gains) > 1 else float("inf")
    return float(gains.mean()), noise


def decibels(errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """PSNR of mean squared errors in a range of 1; capped at 120."""
    return np.asarray(-10 * np.log10(np.maximum(errors, 1e-12)))


def default_rung(settings: ReflectanceSettings) -> Rung:
    """What is fitted when there are too few views to vote."""
    brdf = "dielectric" if settings.brdf == "auto" else settings.brdf
    return Rung(brdf=brdf, specular="uniform", light_frame=_first_frame(settings))


def forced_rung(settings: ReflectanceSettings) -> Rung | None:
    """The rung that `reflectance.model` names; None for `auto`."""
    if settings.model == "auto":
        return None
    brdf = "dielectric" if settings.brdf == "auto" else settings.brdf
    frame = _first_frame(settings)
    rungs = {
        "diffuse": Rung(light_frame=frame),
        "specular": Rung(brdf, "uniform", light_frame=frame),
        "specular_map": Rung(brdf, "map", light_frame=frame),
        "roughness_map": Rung(brdf, "map", "map", light_frame=frame),
    }
    if settings.model not in rungs:
        raise ConfigError(f"reflectance.model is {settings.model!r}; it is auto or one of: {', '.join(rungs)}")
    return rungs[settings.model]


def _first_frame(settings: ReflectanceSettings) -> Literal["world", "camera"]:
    return "world" if settings.light_frame == "auto" else settings.light_frame
