"""An interrupted fit on cached transport is resumed bit for bit, and steps without a finite gradient are skipped."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import pytest
import torch

from hir_core.errors import StageError
from hir_core.plugins.model_spec import ModelSpec
from hir_plugins.reflectance_renderers.transport_ggx.fit import joint_optimization
from hir_plugins.reflectance_renderers.transport_ggx.fit.fit_checkpoints import FitCheckpoint
from hir_plugins.reflectance_renderers.transport_ggx.fit.fit_settings import FitSettings
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.pixel_batches import PixelBatch
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from tests.hir_plugins.reflectance_renderers.transport_ggx.test_light_and_albedo import solver_of

SPEC = ModelSpec("dielectric", "uniform")
SETTINGS = FitSettings(24, "dielectric", 0, refresh_interval=5, alpha_frozen_share=0.1)


def run(resident: int, checkpoint: FitCheckpoint | None = None, stop: int = -1, spec: ModelSpec = SPEC) -> Parameters:
    """A fit of 24 steps with some batches in memory, interrupted after the step `stop`."""
    solver, _ = solver_of(block_pixels=200, resident_pixels=resident)
    observed = solver._pixels.of(range(6))

    def interrupt(step: int, _: float) -> None:
        if step == stop:
            raise KeyboardInterrupt

    start = solver._initial_parameters(spec, None, observed)
    batches = solver._pixels.batches(observed, spec)
    settings = replace(SETTINGS, model=spec.brdf)
    return joint_optimization.fit(solver._transport, batches, start, settings, solver._edges, interrupt, checkpoint)


@pytest.mark.parametrize(
    ("stop", "resident"),
    [
        pytest.param(3, 1 << 20, id="3-all in memory", marks=pytest.mark.slow),
        pytest.param(3, 400, id="3-shards"),
        pytest.param(12, 1 << 20, id="12-all in memory"),
        pytest.param(12, 400, id="12-shards"),
    ],
)
def test_an_interrupted_fit_ends_with_the_same_bits(tmp_path: Path, resident: int, stop: int) -> None:
    checkpoint = FitCheckpoint(tmp_path / "fit", -1.0)
    with pytest.raises(KeyboardInterrupt):
        run(resident, checkpoint, stop)
    assert checkpoint.has_state() == (stop > 5)
    resumed, whole = run(resident, checkpoint), run(resident)
    for field in fields(Parameters):
        a, b = getattr(resumed, field.name), getattr(whole, field.name)
        assert (a is None and b is None) or torch.equal(a, b), field.name


@pytest.mark.parametrize(
    "spec",
    [
        ModelSpec("metallic", "uniform", metalness="metal"),
        pytest.param(ModelSpec("metallic", "uniform", metalness="map"), marks=pytest.mark.slow),
        pytest.param(ModelSpec("dielectric", "uniform", lamp=True), marks=pytest.mark.slow),
        pytest.param(ModelSpec("dielectric", "uniform", roughness="map"), marks=pytest.mark.slow),
    ],
    ids=["metal", "map", "lamp", "roughness"],
)
def test_an_interrupted_fit_of_more_parameters_ends_with_the_same_bits(tmp_path: Path, spec: ModelSpec) -> None:
    """Metalness is part of the state, infinite logits included; its prior grows with the step. So are a lamp and its
    shadows, and the mean width of a map, which stays between two searches.
    """
    checkpoint = FitCheckpoint(tmp_path / "fit", -1.0)
    with pytest.raises(KeyboardInterrupt):
        run(400, checkpoint, 12, spec)
    assert checkpoint.has_state()
    resumed, whole = run(400, checkpoint, spec=spec), run(400, spec=spec)
    for field in fields(Parameters):
        a, b = getattr(resumed, field.name), getattr(whole, field.name)
        assert (a is None and b is None) or torch.equal(a, b), field.name


def fit_with_broken_view(steps: int) -> Parameters:
    """A fit whose pixels of view 3 are not finite."""
    solver, _ = solver_of()
    observed = solver._pixels.of(range(6))
    batches = solver._pixels.batches(observed, SPEC)

    def make(parameters: Parameters, number: int) -> PixelBatch:
        batch = batches.make(parameters, number)
        return replace(batch, color_srgb=torch.where((batch.view == 3)[:, None], torch.nan, batch.color_srgb))

    settings = replace(SETTINGS, steps=steps, solve_albedo=False)
    start = solver._initial_parameters(SPEC, None, observed)
    broken = replace(batches, make=make)
    return joint_optimization.fit(solver._transport, broken, start, settings, solver._edges, lambda *_: None)


def test_skipped_steps_are_warned_of_with_their_views() -> None:
    with pytest.warns(UserWarning, match=r"10 of 10 steps of the dielectric fit were skipped: .* of views \[3\]"):
        fitted = fit_with_broken_view(10)
    assert bool(torch.isfinite(fitted.diffuse).all())


def test_only_broken_steps_are_an_error_with_advice() -> None:
    with pytest.raises(StageError, match=r"the dielectric fit: 20 steps in a row.*of views \[3\].*hir check"):
        fit_with_broken_view(30)
