"""Steps, learning rates and weights of a fit, for a model and what an earlier fit has of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from hir_core.plugins.model_spec import ModelSpec
from hir_plugins.reflectance_renderers.brdf_torch import Model
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from hir_plugins.reflectance_renderers.transport_ggx.fit.smoothness import SmoothnessWeights
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions

FIRST_ALBEDO_SHARE = 1 / 3
"""Of the albedo's learning rate in a fit from nothing: at the full rate wide variations of the albedo explain shading
before the light does (docs/studies/values_of_maps.md)."""
WARM_UP_SHARE = 0.2
"""Of the steps of a fit that goes on from another one with the same lobes. A new lobe or a new map of metalness needs
all steps (docs/studies/values_of_maps.md)."""
METAL_COLOR_FROZEN_SHARE = 0.5
"""Of the first fit of a metal: the light is fitted to its reflections before its base colour varies
(docs/studies/initial_guess.md)."""
EXPOSURE_EFFORT = 1.0
"""Least effort of a fit that changes exposures which an earlier one had: in shorter ones, of a material that may be
wrong, they would absorb its errors (docs/studies/exposures.md)."""

ENTROPY_EFFORT = 1.0
"""Effort of a fit from which the entropy of the albedo has no weight. Shorter fits come before it and lead light and
albedo near the right ones; then the photographs alone decide (docs/studies/albedo_entropy.md)."""


@dataclass(frozen=True)
class FitSettings:
    """Steps, learning rates and weights of a fit."""

    steps: int
    model: Model | Literal["diffuse"]
    bounces: int
    light_rate: float = 0.08
    diffuse_rate: float = 0.06
    specular_rate: float = 0.05
    width_rate: float = 0.08
    exposure_rate: float = 0.05
    normal_rate: float = 0.03
    metalness_rate: float = 0.15
    lamp_rate: float = 0.08
    warm_up_share: float = 0.0
    """Share of the steps in which the rates rise from nothing. Adam's first steps have the length of the rate, however
    small the gradient is: a fit that goes on from another one would first move away from it."""
    alpha_frozen_share: float = 0.2
    """Share of the steps before α changes where lobes are new: under a light that is still uniform it has no meaning.
    Where a fit with lobes goes on it is 0. With 1 α stays as it is."""
    color_frozen_share: float = 0.0
    """Share of the steps before the base colour changes. A metal shows its reflections alone: while the light is still
    uniform, base colours of its vertices would explain them."""
    exposure_frozen_share: float = 0.0
    """Share of the steps before exposures change: while light and albedo are wrong, they would absorb their errors."""
    f0_frozen_share: float = 0.7
    """Share of the steps before F0 of the dielectric part changes: while metalness is undecided, metal imitates it."""
    refresh_interval: int = 15
    """Steps between updates of the specular matrices to the current α."""
    smoothness: SmoothnessWeights = field(default_factory=SmoothnessWeights)
    albedo_entropy: float = 0.0
    """Weight of the entropy of the albedo at the first step; it falls to 0 at the last one."""
    seed: int = 0
    """Of the vertices that are drawn for it."""
    huber_srgb: float = 0.1
    """Residual in sRGB from which the loss is linear."""
    known_light: bool = False
    fits_exposures: bool = False
    """Exposures are fitted, not recorded; without any in the parameters all are equal."""
    solve_albedo: bool = True
    """End with the albedos in closed form."""


def settings_of_fit(
    options: TransportGGXOptions,
    spec: ModelSpec,
    parameters: Parameters,
    before: Parameters | None,
    effort: float,
    guess_is_uniform: bool,
) -> FitSettings:
    """Settings of a fit of a model that starts at `parameters`.

    `before`: what the earlier fit found, None for a fit from nothing; `effort`: share of the steps of a full fit;
    `guess_is_uniform`: whether a fit from nothing starts with one albedo for all vertices.
    """
    settings = FitSettings(
        max(1, round(options.steps * effort)),
        spec.brdf,
        spec.bounces,
        known_light=spec.light_is_known,
        fits_exposures=spec.exposures == "fitted",
        smoothness=SmoothnessWeights(
            light=options.light_smoothness,
            light_chroma=options.light_whiteness,
            albedo=options.albedo_smoothness,
            metalness_prior=options.metalness_prior,
        ),
        albedo_entropy=0.0 if spec.light_is_known or effort >= ENTROPY_EFFORT else options.albedo_entropy,
        seed=options.seed,
    )
    if before is None:
        settings = replace(settings, exposure_frozen_share=1.0)
        if not spec.light_is_known:
            settings = replace(settings, diffuse_rate=FIRST_ALBEDO_SHARE * settings.diffuse_rate)
        if parameters.is_metal and guess_is_uniform:
            settings = replace(settings, color_frozen_share=METAL_COLOR_FROZEN_SHARE)
        return settings
    if before.width is not None:
        settings = replace(settings, alpha_frozen_share=0.0)
    if not parameters.has_new_lobe(before):
        settings = replace(settings, warm_up_share=WARM_UP_SHARE)
        if parameters.normal_offset is not None and parameters.width is not None and len(parameters.width) == 1:
            # beside normals, which place a highlight where few photographs show it, a lobe becomes too narrow
            settings = replace(settings, alpha_frozen_share=1.0)
    if effort < EXPOSURE_EFFORT and before.log_exposure is not None:
        settings = replace(settings, exposure_frozen_share=1.0)
    return settings
