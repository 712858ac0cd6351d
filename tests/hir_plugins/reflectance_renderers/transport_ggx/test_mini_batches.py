"""What a fit holds in memory: nothing of all pixels at once, nothing twice."""

from __future__ import annotations

import weakref
from dataclasses import replace

import pytest
import torch

from hir_core.plugins.model_spec import ModelSpec
from hir_plugins.reflectance_renderers.transport_ggx import solver
from hir_plugins.reflectance_renderers.transport_ggx.fit import joint_optimization
from hir_plugins.reflectance_renderers.transport_ggx.fit.joint_optimization import FitSettings
from hir_plugins.reflectance_renderers.transport_ggx.fit.observed_pixels import ObservedPixels
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from hir_plugins.reflectance_renderers.transport_ggx.fit.pixel_batches import PixelBatch
from hir_plugins.reflectance_renderers.transport_ggx.operator.camera_light import irradiance_of, pixel_irradiance
from hir_plugins.reflectance_renderers.transport_ggx.operator.specular_lobes import Lobes
from tests.hir_plugins.reflectance_renderers.transport_ggx.test_light_and_albedo import solver_of


def test_irradiance_of_many_points_is_that_of_their_matrix(monkeypatch: pytest.MonkeyPatch) -> None:
    fit, _ = solver_of()
    points = fit._photographs(range(2)).points
    sources = torch.rand(fit._transport.pyramid.texels + len(fit._transport.irradiance_cache), 3)
    monkeypatch.setattr(camera_light, "PIXELS_AT_ONCE", len(points) // 3)
    given = (fit._transport, points, 4, fit._rotation)
    assert torch.equal(irradiance_of(*given, sources), pixel_irradiance(*given).matrix @ sources)


def test_a_fit_under_a_moving_light_begins_without_the_matrix_of_all_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    """300 views of 512²: it took 2 GB for the mean of three numbers."""
    fit, _ = solver_of()
    monkeypatch.setattr(solver, "pixel_irradiance", lambda *_: pytest.fail("3 kB a pixel"))
    begun = fit._begin(ModelSpec(light_frame="camera"), None, fit._photographs(range(6)))
    assert bool(torch.isfinite(begun.diffuse).all())


def test_lobes_are_let_go_before_new_ones_are_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    fit, _ = solver_of()
    spec, photographs = ModelSpec("dielectric", "uniform"), fit._photographs(range(6))
    earlier: list[weakref.ref[Lobes]] = []
    monkeypatch.setattr(joint_optimization, "_drifted", lambda *_: True)

    whole = fit._stream(photographs, spec)

    def make(state: Parameters, number: int) -> PixelBatch:
        assert all(lobes() is None for lobes in earlier), "the lobes of both widths at once"
        block = whole.make(state, number)
        assert block.lobes is not None
        earlier.append(weakref.ref(block.lobes))
        return block

    settings = FitSettings(20, "dielectric", 0, refresh=5)
    start = fit._begin(spec, None, photographs)
    joint_optimization.fit(fit._transport, replace(whole, make=make), start, settings, fit._edges, lambda *_: None)
    assert len(earlier) == 5, "one at the start, and one at each refresh"


def test_a_stream_shows_every_pixel_and_holds_no_more_blocks_than_it_may(monkeypatch: pytest.MonkeyPatch) -> None:
    fit, _ = solver_of(block_pixels=200, resident_pixels=400)
    photographs = fit._photographs(range(6))
    alive: list[weakref.ref[Lobes]] = []
    shown: set[int] = set()
    most = 0
    block_of = fit._block

    def counted(part: ObservedPixels, spec: ModelSpec, state: Parameters, number: int) -> PixelBatch:
        nonlocal most
        block: PixelBatch = block_of(part, spec, state, number)
        assert block.lobes is not None
        alive.append(weakref.ref(block.lobes))
        shown.add(number)
        most = max(most, sum(lobes() is not None for lobes in alive))
        return block

    monkeypatch.setattr(fit, "_block", counted)
    spec = ModelSpec("dielectric", "uniform")
    stream = fit._stream(photographs, spec)
    settings = FitSettings(15 * stream.shards, "dielectric", 0)
    joint_optimization.fit(
        fit._transport, stream, fit._begin(spec, None, photographs), settings, fit._edges, lambda *_: None
    )
    assert stream.shards > 2 and shown == set(range(stream.count))
    assert most <= 2, "blocks of two turns at once"


def test_a_fit_in_turns_ends_near_the_one_that_holds_all() -> None:
    spec, every = ModelSpec("dielectric", "uniform"), range(6)
    errors = []
    for resident in (1 << 20, 400):
        fit, _ = solver_of(block_pixels=200, resident_pixels=resident)
        errors.append(fit.errors(fit.fit(spec, None, every, 1.0, lambda _: None), every).mean())
    assert errors[1] < 1.6 * errors[0] < 1e-6, "66.7 dB, and 65.5 in turns"
