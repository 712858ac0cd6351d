"""The report of the reflectance stage: what run.json holds of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import Scene
from hir_core.stages.reflectance.model_selection import Comparison


@dataclass(frozen=True)
class ComparisonReport:
    """One candidate of the model selection; dB rounded to 0.001."""

    model: str
    """Name of the candidate."""
    spec: ModelSpec
    held_out_db: float
    gain_db: float
    standard_error_db: float
    accepted: bool


@dataclass(frozen=True)
class RefinementReport:
    """A step after the fit that is accepted only where held-out views gain: mean PSNR on them before and after."""

    accepted: bool
    held_out_views: int
    not_compared: str | None = None
    """Why nothing was compared."""
    renderer: str | None = None
    steps: int | None = None
    """Gradient steps; None for a closed form."""
    before_db: float | None = None
    after_db: float | None = None
    gain_db: float | None = None
    standard_error_db: float | None = None


@dataclass(frozen=True)
class GradientReport:
    """A fit by gradient steps."""

    steps: int
    skipped: Mapping[str, int]
    """Steps that were skipped because a term or its gradient was not finite, by term."""


@dataclass(frozen=True)
class TermReport:
    """A regularizer of the fit; its processor time is in timings.json."""

    weight: float
    value: float
    """Unweighted, at the fitted scene; 4 significant digits."""
    acted_in: Literal["solver", "gradient steps"]


@dataclass(frozen=True)
class LightAndMaterial:
    """Averages of the fitted light and material."""

    light_mean: tuple[float, ...]
    """RGB."""
    light_max: float
    brdf: str
    specular_albedo: float
    roughness_alpha: float

    @classmethod
    def of(cls, scene: Scene) -> LightAndMaterial:
        """Of a fitted scene."""
        assert scene.environment is not None and scene.material is not None
        radiance, material = scene.environment.radiance, scene.material
        return cls(
            tuple(round(float(v), 5) for v in radiance.mean(dim=(0, 1))),
            round(float(radiance.max()), 4),
            material.model,
            round(float(material.specular_albedo.mean()), 5),
            round(float(material.roughness.mean()), 5),
        )


@dataclass(frozen=True)
class ReflectanceReport:
    """What the stage fitted, how the model was selected, and what each later step gained."""

    method: Literal["solver", "gradient"]
    model: str
    """Name of the fitted model."""
    light_frame: str
    fitted: LightAndMaterial
    bounces: int | None = None
    """Reflections between parts of the surface that the solver modelled."""
    comparisons: tuple[ComparisonReport, ...] = ()
    solver: Mapping[str, Any] | None = None
    """Figures of the solver's own."""
    gradient: GradientReport | None = None
    regularizers: Mapping[str, TermReport] | None = None
    """By name; None without any."""
    albedo_refinement: RefinementReport | None = None
    path_tracing: RefinementReport | None = None
    clamped_share: float | None = None
    """Share of diffuse albedo values that energy conservation reduced."""

    def as_document(self) -> dict[str, Any]:
        """For run.json: without optional parts that are None, light and material at the top."""
        document = asdict(self)
        return _without_none(document | document.pop("fitted"))


def comparison_reports(comparisons: Sequence[Comparison]) -> tuple[ComparisonReport, ...]:
    """The comparisons of a model selection for run.json."""
    return tuple(
        ComparisonReport(
            c.spec.name,
            c.spec,
            round(c.held_out_db, 3),
            round(c.gain_db, 3),
            round(c.standard_error_db, 3),
            c.accepted,
        )
        for c in comparisons
    )


def significant(value: float) -> float:
    """A number rounded to 4 significant digits."""
    return float(f"{value:.4g}")


def _without_none(table: Mapping[str, Any]) -> dict[str, Any]:
    return {
        key: _without_none(value) if isinstance(value, Mapping) else value
        for key, value in table.items()
        if value is not None
    }
