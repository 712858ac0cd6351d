"""Memory of a fit: no matrices of all pixels at once, and no lobes twice."""

from __future__ import annotations

import weakref
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from hir_core.plugins.model_spec import ModelSpec
from hir_plugins.reflectance_renderers.transport_ggx.fit import joint_optimization
from hir_plugins.reflectance_renderers.transport_ggx.fit.fit_settings import FitSettings
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.observed_pixels import ObservedPixels
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.pixel_batches import PixelBatch
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.resident_batches import ResidentBatches
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from hir_plugins.reflectance_renderers.transport_ggx.operator import camera_light
from hir_plugins.reflectance_renderers.transport_ggx.operator.camera_light import irradiance_of, pixel_irradiance
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.specular_lobes import Lobes
from tests.hir_plugins.reflectance_renderers.transport_ggx.test_light_and_albedo import solver_of


def test_irradiance_of_many_points_is_that_of_their_matrix(monkeypatch: pytest.MonkeyPatch) -> None:
    fit, _ = solver_of()
    points = fit._pixels.of(range(2)).points
    sources = torch.rand(fit._transport.pyramid.texels + len(fit._transport.irradiance_cache), 3)
    monkeypatch.setattr(camera_light, "PIXELS_PER_CHUNK", len(points) // 3)
    arguments = (fit._transport, points, 4, fit._rotation)
    assert torch.equal(irradiance_of(*arguments, sources), pixel_irradiance(*arguments).matrix @ sources)


class LargestTensor(TorchDispatchMode):
    """Records the number of elements of the largest dense tensor that an operation returns."""

    elements = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        result = func(*args, **(kwargs or {}))
        for leaf in tree_leaves(result):
            if isinstance(leaf, torch.Tensor) and leaf.layout == torch.strided:
                self.elements = max(self.elements, leaf.numel())
        return result


def test_the_initial_guess_under_a_moving_light_needs_no_matrix_of_all_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    """For 300 views of 512² the matrix takes 2 GB, and only the mean of three numbers is needed."""
    fit, _ = solver_of()
    photographs = fit._pixels.of(range(6))
    with LargestTensor() as matrix:
        pixel_irradiance(fit._transport, photographs.points, fit._options.diffuse_samples, fit._rotation)
    assert matrix.elements >= len(photographs) * fit._options.diffuse_samples, "the matrix is recorded"
    monkeypatch.setattr(camera_light, "PIXELS_PER_CHUNK", len(photographs) // 8)
    with LargestTensor() as guess:
        initial = fit._initial_parameters(ModelSpec(light_frame="camera"), None, photographs)
    assert guess.elements < matrix.elements / 4
    assert bool(torch.isfinite(initial.diffuse).all())


def test_lobes_are_freed_before_new_ones_are_sampled(monkeypatch: pytest.MonkeyPatch) -> None:
    fit, _ = solver_of()
    spec, photographs = ModelSpec("dielectric", "uniform"), fit._pixels.of(range(6))
    earlier: list[weakref.ref[Lobes]] = []
    monkeypatch.setattr(ResidentBatches, "_have_drifted", lambda _: True)

    batches = fit._pixels.batches(photographs, spec)

    def make(state: Parameters, number: int) -> PixelBatch:
        assert all(lobes() is None for lobes in earlier), "lobes of two widths at once"
        batch = batches.make(state, number)
        assert batch.lobes is not None
        earlier.append(weakref.ref(batch.lobes))
        return batch

    settings = FitSettings(20, "dielectric", 0, refresh_interval=5)
    start = fit._initial_parameters(spec, None, photographs)
    joint_optimization.fit(fit._transport, replace(batches, make=make), start, settings, fit._edges, lambda *_: None)
    assert len(earlier) == 5, "one for the initial guess, and one for each refresh"


def test_every_batch_is_used_and_no_more_are_in_memory_than_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    fit, _ = solver_of(block_pixels=200, resident_pixels=400)
    photographs = fit._pixels.of(range(6))
    alive: list[weakref.ref[Lobes]] = []
    used: set[int] = set()
    most = 0
    make_batch = fit._pixels.batch

    def counted(
        part: ObservedPixels, spec: ModelSpec, state: Parameters, number: int, directions: int, irradiance: None
    ) -> PixelBatch:
        nonlocal most
        batch: PixelBatch = make_batch(part, spec, state, number, directions, irradiance)
        assert batch.lobes is not None
        alive.append(weakref.ref(batch.lobes))
        used.add(number)
        most = max(most, sum(lobes() is not None for lobes in alive))
        return batch

    monkeypatch.setattr(fit._pixels, "batch", counted)
    spec = ModelSpec("dielectric", "uniform")
    batches = fit._pixels.batches(photographs, spec)
    settings = FitSettings(15 * batches.shards, "dielectric", 0)
    joint_optimization.fit(
        fit._transport, batches, fit._initial_parameters(spec, None, photographs), settings, fit._edges, lambda *_: None
    )
    assert batches.shards > 2 and used == set(range(batches.count))
    assert most <= 3, "at once: the two batches of a shard, and the sample on which widths are compared"


@pytest.mark.slow
def test_a_fit_in_shards_is_nearly_as_good_as_one_in_memory() -> None:
    """Without the grid for few pixels, which limits the fit of these to 60 dB."""
    spec, every = ModelSpec("dielectric", "uniform"), range(6)
    errors = []
    for resident in (1 << 20, 400):
        fit, _ = solver_of(block_pixels=200, resident_pixels=resident, pixels_per_value=0.0)
        errors.append(fit.errors(fit.fit(spec, None, every, 1.0, lambda _: None), every).mean())
    assert errors[1] < 1.6 * errors[0] < 1e-6, "66.7 dB, and 65.5 in shards"
