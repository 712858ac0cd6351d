"""Light and material fitted together on cached transport: a few hundred noise-free steps of Adam, then closed form.

Albedos, ρs, metalness and α belong to the vertices of the refined surface (or are uniform); the light is the logarithm
of its texels. Textures are solved afterwards at their own resolution (`textures/`).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from hir_core.optimization.nonfinite_diagnostics import nonfinite_elements
from hir_core.optimization.optimization_loop import optimize, warn_of_skipped_steps
from hir_core.optimization.schedules import Schedule
from hir_plugins.reflectance_renderers.transport_ggx.fit.albedo_entropy import albedo_entropy
from hir_plugins.reflectance_renderers.transport_ggx.fit.final_albedo import solve_final_albedo
from hir_plugins.reflectance_renderers.transport_ggx.fit.fit_checkpoints import FitCheckpoint
from hir_plugins.reflectance_renderers.transport_ggx.fit.fit_settings import FitSettings
from hir_plugins.reflectance_renderers.transport_ggx.fit.fit_terms import FitTerms
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.mini_batches import MiniBatches
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.pixel_batches import (
    PixelBatch,
    predict,
    refresh_matrices,
    specular_matrices,
    srgb_residual,
    with_exposure,
)
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.resident_batches import ResidentBatches
from hir_plugins.reflectance_renderers.transport_ggx.fit.gradient_grid import GradientGrid
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import MAX_FITTED_F0, Parameters
from hir_plugins.reflectance_renderers.transport_ggx.fit.smoothness import smoothness_energy
from hir_plugins.reflectance_renderers.transport_ggx.fit.width_search import searched_width
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.specular_radiance import SpecularMatrices

ADAM_BETAS = (0.9, 0.99)
PIXEL_TERM = "pixels"
ADVICE = "look for broken pixels or triangles with: hir check"


def fit(
    transport: Transport,
    batches: MiniBatches,
    start: Parameters,
    settings: FitSettings,
    edges: Int[Tensor, "E 2"],
    on_step: Callable[[int, float], None],
    checkpoint: FitCheckpoint | None = None,
    terms: FitTerms | None = None,
    grid: GradientGrid | None = None,
) -> Parameters:
    """Adam over the batches in turn, with a cosine schedule after the warm-up; `on_step(step, loss)` receives the loss
    of the pixels and of the `terms`, which are regularizers. With `grid` the gradients of maps at vertices are
    smoothed, and their smoothness prior is that of values which are a cell apart.

    With `checkpoint` the state is stored there and resumed. A step without a finite gradient is skipped and warned of,
    with its term and views; too many in a row raise `StageError`.
    """
    if grid is not None:
        settings = replace(settings, smoothness=replace(settings.smoothness, spacing=grid.spacing))
    prepared = None if terms is None else terms.prepared(start.detached(), settings.model, settings.huber_srgb)
    parameters = _leaves(start.detached(), settings)

    def predicted(batch: PixelBatch, matrices: SpecularMatrices, at: Parameters) -> Tensor:
        # without the lamp, whose derivative in α is exact
        return predict(transport, batch, matrices, replace(at, lamp=None), settings.bounces)

    resident = ResidentBatches(
        batches, parameters, start.detached(), settings.model, settings.refresh_interval, predicted
    )
    has_width_map = parameters.width is not None and len(parameters.width) > 1
    fitted_loss, searched_at, mean_width = math.nan, -1, math.nan

    def search_width(step: int) -> None:
        nonlocal searched_at, mean_width
        if step == searched_at or step % settings.refresh_interval or parameters.width is None:
            return
        searched_at = step
        if step >= settings.alpha_frozen_share * settings.steps:
            regularizers = None if prepared is None else prepared.of_widths(parameters, step)

            def loss_of(moved: Parameters) -> float:
                with torch.no_grad():
                    pixels = sample_loss(transport, batches, moved, settings)
                return pixels if regularizers is None else pixels + regularizers(moved)

            parameters.width.data.copy_(searched_width(parameters, loss_of))
            mean_width = float(parameters.width.detach().mean())

    def loss(step: int) -> dict[str, Tensor]:
        nonlocal fitted_loss
        search_width(step)
        batch, matrices = resident.at(step)
        # metal or not is decided late: while light and colours are wrong, the nearer end of m is no evidence
        decided = replace(
            settings.smoothness, metalness_prior=settings.smoothness.metalness_prior * step / settings.steps
        )
        own = objective(transport, batch, matrices, parameters, replace(settings, smoothness=decided), edges)
        if settings.albedo_entropy:
            weight = settings.albedo_entropy * (1 - step / settings.steps)
            own["entropy of the albedo"] = weight * albedo_entropy(parameters.diffuse, (settings.seed, step))
        regularizers = {} if prepared is None else prepared(parameters, step)
        fitted_loss = sum(float(term.detach()) for term in (own[PIXEL_TERM], *regularizers.values()))
        return own | regularizers

    def freeze(step: int) -> None:
        smooth_gradients(parameters, grid)
        is_frozen = step < settings.alpha_frozen_share * settings.steps
        if parameters.width is not None and (is_frozen or not has_width_map):
            parameters.width.grad = None  # a uniform width is searched, for the terms, too
        if parameters.log_exposure is not None and step < settings.exposure_frozen_share * settings.steps:
            parameters.log_exposure.grad = None
        if step < settings.color_frozen_share * settings.steps:
            parameters.diffuse.grad = None
        if parameters.metalness is not None and step < settings.f0_frozen_share * settings.steps:
            assert parameters.specular is not None
            parameters.specular.grad = None

    def after_step(step: int) -> bool:
        if parameters.specular is not None and settings.model in ("dielectric", "metallic"):
            with torch.no_grad():
                parameters.specular.clamp_(max=math.log(MAX_FITTED_F0 / (1 - MAX_FITTED_F0)))
        if has_width_map and math.isfinite(mean_width):  # before the first search there is none
            assert parameters.width is not None
            parameters.width.data.add_(mean_width - parameters.width.data.mean())
        if math.isfinite(fitted_loss):
            on_step(step, fitted_loss)
        return False

    def locate(step: int, term: str) -> str:
        batch, matrices = resident.at(step)
        with torch.no_grad():
            difference = _difference(transport, batch, matrices, parameters, settings)
        nonfinite = ~torch.isfinite(difference).all(dim=1)
        if term == PIXEL_TERM and bool(nonfinite.any()):
            return f"{int(nonfinite.sum())} pixels of views {batch.view[nonfinite].unique().tolist()}"
        named = {f.name: getattr(parameters, f.name) for f in fields(parameters)}
        return nonfinite_elements({name: value for name, value in named.items() if value is not None})

    description = f"the {settings.model} fit"
    result = optimize(
        loss,
        torch.optim.Adam(_groups(parameters, settings), betas=ADAM_BETAS),
        Schedule(settings.steps, round(settings.warm_up_share * settings.steps), end=0.0),
        stage=f"reflectance, {description}",
        after_backward=freeze,
        after_step=after_step,
        checkpointing=None if checkpoint is None else checkpoint.checkpointing(settings.refresh_interval),
        extra_state=resident,
        locate=locate,
        advice=ADVICE,
    )
    warn_of_skipped_steps(result, lambda text: warnings.warn(f"{text}; {ADVICE}", stacklevel=4), description)
    fitted = parameters.detached()
    if not settings.solve_albedo:
        return fitted
    refiner = None if prepared is None else prepared.albedo_refiner(fitted)
    return solve_final_albedo(transport, resident.all(), fitted, settings.bounces, refiner)


def smooth_gradients(parameters: Parameters, grid: GradientGrid | None) -> None:
    """Smooths the gradients of all maps at vertices."""
    if grid is None:
        return
    maps = (parameters.diffuse, parameters.specular, parameters.width, parameters.metalness, parameters.normal_offset)
    for value in maps:
        if value is not None and value.grad is not None and len(value) == grid.vertices:
            value.grad = grid.smoothed(value.grad)


def objective(
    transport: Transport,
    batch: PixelBatch,
    matrices: SpecularMatrices | None,
    parameters: Parameters,
    settings: FitSettings,
    edges: Int[Tensor, "E 2"],
) -> dict[str, Float[Tensor, ""]]:
    """The terms of the solver's own: the error of the pixels and the smoothness."""
    difference = _difference(transport, batch, matrices, parameters, settings)
    pixels = torch.nn.functional.huber_loss(difference, torch.zeros_like(difference), delta=settings.huber_srgb)
    return {
        PIXEL_TERM: pixels,
        "smoothness": smoothness_energy(parameters, settings.smoothness, edges, transport.takes.count),
    }


def sample_loss(transport: Transport, batches: MiniBatches, parameters: Parameters, settings: FitSettings) -> float:
    """The loss of a small batch of pixels, with lobes drawn for the parameters."""
    batch = [batches.sample(parameters)]
    matrices = specular_matrices(batch, settings.model)
    refresh_matrices(batch, matrices, parameters)
    difference = _difference(transport, batch[0], matrices[0], parameters, settings)
    return float(torch.nn.functional.huber_loss(difference, torch.zeros_like(difference), delta=settings.huber_srgb))


def _difference(
    transport: Transport,
    batch: PixelBatch,
    matrices: SpecularMatrices | None,
    parameters: Parameters,
    settings: FitSettings,
) -> Float[Tensor, "P 3"]:
    radiance = predict(transport, batch, matrices, parameters, settings.bounces)
    return srgb_residual(batch, with_exposure(batch, radiance, parameters))


def _leaves(parameters: Parameters, settings: FitSettings) -> Parameters:
    for value in (
        parameters.diffuse,
        parameters.specular,
        parameters.width,
        parameters.normal_offset,
        parameters.lamp,
    ):
        if value is not None:
            value.requires_grad_()
    if parameters.log_exposure is not None:
        parameters.log_exposure.requires_grad_(settings.fits_exposures)
    if parameters.metalness is not None and not parameters.is_metal:
        parameters.metalness.requires_grad_()
    parameters.light.requires_grad_(not settings.known_light)
    if settings.model == "diffuse":
        return replace(parameters, specular=None, width=None)
    return parameters


def _groups(parameters: Parameters, settings: FitSettings) -> list[dict[str, Any]]:
    """Adam's parameter groups, each with its learning rate."""
    rates = (
        (parameters.light, settings.light_rate),
        (parameters.diffuse, settings.diffuse_rate),
        (parameters.specular, settings.specular_rate),
        (parameters.width, settings.width_rate),
        (parameters.log_exposure, settings.exposure_rate),
        (parameters.normal_offset, settings.normal_rate),
        (parameters.metalness, settings.metalness_rate),
        (parameters.lamp, settings.lamp_rate),
    )
    return [{"params": [p], "lr": rate} for p, rate in rates if p is not None and p.requires_grad]
