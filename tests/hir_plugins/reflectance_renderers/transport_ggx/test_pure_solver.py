"""Results of the solver depend on the arguments of a call alone, never on the calls before it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from hir_core.capture import Capture
from hir_core.optimization.linear_maps import LinearMap
from hir_core.optimization.parallel_jobs import StopSignal, run_in_parallel
from hir_core.plugins.interfaces import CheckpointLocation
from hir_core.plugins.manager import PluginManager
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import Material, Scene
from hir_core.stages.atlas import unwrap_mesh
from hir_plugins.reflectance_renderers.transport_ggx.fit import joint_optimization
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_model import Fit
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels import photograph_pixels
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import MAX_FITTED_F0
from hir_plugins.reflectance_renderers.transport_ggx.operator.camera_light import pixel_irradiance
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.renderer import TransportGGX
from hir_plugins.reflectance_renderers.transport_ggx.solver import TransportSolver
from tests.fixtures.made_captures import BROWN, TEXELS, around, bowl, lamps, make_material, photographs

VIEWS = range(6)
OPTIONS = TransportGGXOptions(vertices=0, cache_cells=200, steps=12)
DIRECT = ModelSpec(light_is_known=True)
INDIRECT = ModelSpec(light_is_known=True, bounces=1)


@pytest.fixture(scope="module")
def capture() -> tuple[Scene, Capture]:
    """A bowl under lamps, with a grey texture, and its photographs."""
    truth = Scene(unwrap_mesh(bowl(), TEXELS)[0], make_material(BROWN), lamps())
    grey = make_material(torch.full((TEXELS, TEXELS, 3), 0.5))
    return replace(truth, material=grey), photographs(truth, around(len(VIEWS)))


def solver_of(capture: tuple[Scene, Capture], options: TransportGGXOptions = OPTIONS) -> TransportSolver:
    return TransportGGX(options).prepare(*capture)


def silent(share: float) -> None:
    """Ignores the progress."""


def albedo(scene: Scene) -> torch.Tensor:
    assert scene.material is not None
    return scene.material.diffuse_albedo


def test_a_scene_is_refined_and_shaded_alike_after_another_scene_was_made(capture: tuple[Scene, Capture]) -> None:
    solver = solver_of(capture)
    pixels = torch.tensor([(5, x, y) for x in range(8, 24) for y in range(8, 24)])  # the inside, from above

    def radiance(scene: Scene) -> torch.Tensor:
        assert scene.material is not None and scene.environment is not None
        return solved.prepared.radiance(scene.material, scene.environment, pixels)

    solved = solver.scene(solver.fit(INDIRECT, None, VIEWS, 1.0, silent), VIEWS, silent)
    refined = solver.refine(solved, None, VIEWS[:4], silent)
    assert refined is not None and refined.prepared is solved.prepared
    before, shaded = albedo(refined.scene), radiance(solved.scene)
    other = solver.scene(solver.fit(DIRECT, None, VIEWS, 0.5, silent), VIEWS, silent)
    assert not torch.equal(albedo(other.scene), albedo(solved.scene))
    again = solver.refine(solved, None, VIEWS[:4], silent)
    assert again is not None and torch.equal(albedo(again.scene), before)
    assert torch.equal(radiance(solved.scene), shaded) and float(shaded.max()) > 0
    material, light = solved.scene.material, solved.scene.environment
    assert material is not None and light is not None
    assert not torch.equal(solver.radiance(material, light, pixels), shaded), "indirect light belongs to the scene"


def test_a_finished_fit_is_read_from_its_checkpoint(capture: tuple[Scene, Capture], tmp_path: Path) -> None:
    """By another solver, whatever it fitted before; without a checkpoint nothing is written."""
    glossy = ModelSpec("paper", "uniform", light_is_known=True)
    location = CheckpointLocation(tmp_path / "fit_1", 0.0)
    fit = solver_of(capture).fit(glossy, None, VIEWS, 1.0, silent, location)
    written = {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert set(written) == {"fit_1.npz", "fit_1_diffuse.npz"}, "the diffuse fit before it has its own"
    resumed = solver_of(capture)
    resumed.fit(DIRECT, None, VIEWS, 0.5, silent)
    shares: list[float] = []
    again = resumed.fit(glossy, None, VIEWS, 1.0, shares.append, location)
    assert shares == [1.0] and {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == written
    assert torch.equal(again.parameters.diffuse, fit.parameters.diffuse)
    assert again.parameters.width is not None and fit.parameters.width is not None
    assert torch.equal(again.parameters.width, fit.parameters.width)


def test_a_control_that_is_fitted_again_after_a_candidate_is_the_same(capture: tuple[Scene, Capture]) -> None:
    """So one control serves all comparisons that continue from one fit: another would bring no new information."""
    solver = solver_of(capture)
    training, held_out = VIEWS[:4], VIEWS[4:]
    spec = ModelSpec(brdf="dielectric", specular="uniform")
    initial = solver.fit(spec, None, training, 1.0, silent)

    def errors(of: ModelSpec) -> list[float]:
        return solver.errors(solver.fit(of, initial, training, 0.5, silent), held_out).tolist()

    control = errors(spec)
    candidate = errors(replace(spec, roughness="map"))
    assert candidate != control
    assert errors(spec) == control


def test_fits_of_three_seeds_differ_and_one_seed_gives_the_same(capture: tuple[Scene, Capture]) -> None:
    """On the same mesh: only the directions and pixels that the renderer draws differ."""
    plugins = PluginManager.discover()
    options = {"vertices": 0, "cache_cells": 200, "steps": 6, "samples": 4}

    def fitted(seed: int) -> torch.Tensor:
        solver = plugins.create("reflectance_renderer", "transport_ggx", options, seed).prepare(*capture)
        spec = ModelSpec(brdf="dielectric", specular="uniform")
        scene = solver.scene(solver.fit(spec, None, VIEWS, 1.0, silent), VIEWS, silent).scene
        return torch.as_tensor(scene.environment.radiance)

    # with two seeds, a solver that only asks whether its seed is 0, or even, would pass
    found = [fitted(seed) for seed in (0, 1, 2)]
    assert torch.equal(fitted(0), found[0]) and torch.equal(fitted(2), found[2])
    assert not any(torch.equal(one, other) for one, other in combinations(found, 2))


@pytest.mark.parametrize("kind", ["dielectric", "mixed"])
def test_the_simpler_model_of_an_initial_guess_is_fitted_once(
    kind: str, capture: tuple[Scene, Capture], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A selection fits diffuse before dielectric and metal before mixed; the result is that of a fit alone."""
    metal = ModelSpec("metallic", "uniform", metalness="metal", light_is_known=True)
    simple, spec = {
        "dielectric": (DIRECT, ModelSpec("dielectric", "uniform", light_is_known=True)),
        "mixed": (metal, replace(metal, metalness="map")),
    }[kind]
    alone = solver_of(capture).fit(spec, None, VIEWS, 1.0, silent, None, 0.5)
    solver = solver_of(capture)
    solver.fit(simple, None, VIEWS, 1.0, silent, None, 0.5)
    fitted: list[str] = []
    true_fit = joint_optimization.fit
    monkeypatch.setattr(
        joint_optimization,
        "fit",
        lambda *arguments, **others: fitted.append(arguments[3].model) or true_fit(*arguments, **others),  # type: ignore[func-returns-value]
    )
    after = solver.fit(spec, None, VIEWS, 1.0, silent, None, 0.5)
    assert "diffuse" not in fitted and len(fitted) <= 4, "short fits for the initial values, and one fit"
    assert torch.equal(after.parameters.light, alone.parameters.light)
    assert torch.equal(after.parameters.diffuse, alone.parameters.diffuse)
    assert solver.fit(simple, None, VIEWS, 1.0, silent, None, 0.25).parameters is not after.parameters


def test_hypotheses_share_the_irradiance_of_their_pixels(
    capture: tuple[Scene, Capture], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Under a light on the camera, rays of hemispheres are traced once; fits and errors are those of a solver alone."""
    options, drawn = replace(OPTIONS, steps=20), list[int]()

    def counted(*arguments: Any) -> LinearMap:
        drawn.append(len(arguments[1]))
        return pixel_irradiance(*arguments)

    monkeypatch.setattr(photograph_pixels, "pixel_irradiance", counted)
    kinds = [ModelSpec(light_frame="camera"), ModelSpec("dielectric", "uniform", light_frame="camera")]
    solver = solver_of(capture, options)
    fits = [solver.fit(kind, None, VIEWS[:4], 1.0, silent, None, 0.5) for kind in kinds]
    errors = [solver.errors(fit, VIEWS[4:]) for fit in fits]
    batches = drawn[:]
    assert len(batches) == 4, "the pixels of the fit, those of short fits, the sample of its widths, the views left out"
    solver.fit(kinds[1], fits[1], VIEWS[:4], 1.0, silent, None, 0.5)
    assert drawn == batches
    for kind, fit, error in zip(kinds, fits, errors, strict=True):
        alone = solver_of(capture, options)
        again = alone.fit(kind, None, VIEWS[:4], 1.0, silent, None, 0.5)
        assert torch.equal(again.parameters.light, fit.parameters.light)
        assert (alone.errors(again, VIEWS[4:]) == error).all()


def test_both_kinds_of_errors_share_their_renderings(
    capture: tuple[Scene, Capture], monkeypatch: pytest.MonkeyPatch
) -> None:
    """And those of another fit, or of other views, are rendered."""
    solver, rendered = solver_of(capture, replace(OPTIONS, steps=5)), list[int]()
    one, other = (solver.fit(ModelSpec(light_frame=f), None, VIEWS[:4], 1.0, silent) for f in ("world", "camera"))  # type: ignore[arg-type]
    predicted = solver._predicted

    def counted(fit: Fit, *rest: Any) -> Any:
        rendered.append(id(fit))
        return predicted(fit, *rest)

    monkeypatch.setattr(solver, "_predicted", counted)
    found = solver.errors(one, VIEWS[4:]), solver.errors_between_lights(one, VIEWS[4:])
    assert rendered == [id(one)]
    assert (found[0].mean() != solver.errors(other, VIEWS[4:]).mean()) and rendered == [id(one), id(other)]
    solver.errors(other, VIEWS[3:])
    assert rendered == [id(one), id(other), id(other)]
    again = solver.errors(one, VIEWS[4:]), solver.errors_between_lights(one, VIEWS[4:])
    assert (np.stack(again) == np.stack(found)).all() and len(rendered) == 4


def test_fits_at_the_same_time_are_those_of_fits_alone(capture: tuple[Scene, Capture]) -> None:
    """Of all kinds and both frames, with what they share: pixels, their irradiance, grids, and the diffuse fit that a
    dielectric starts from, which is fitted once.
    """
    assert TransportSolver.concurrent_fits
    options = replace(OPTIONS, steps=6)
    kinds = [
        ModelSpec("dielectric", "uniform"),
        ModelSpec(),
        ModelSpec("metallic", "uniform", metalness="map"),
        ModelSpec("dielectric", "uniform", bounces=1),
        ModelSpec("dielectric", "uniform", light_frame="camera"),
        ModelSpec(light_frame="camera"),
    ]

    def fitted(at_once: int) -> list[tuple[torch.Tensor, torch.Tensor, list[float]]]:
        solver = solver_of(capture, options)

        def job(spec: ModelSpec) -> tuple[torch.Tensor, torch.Tensor, list[float]]:
            fit = solver.fit(spec, None, VIEWS[:4], 1.0, silent, None, 0.5)
            return fit.parameters.light, fit.parameters.diffuse, solver.errors(fit, VIEWS[4:]).tolist()

        return run_in_parallel([partial(job, spec) for spec in kinds], at_once, StopSignal())

    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        alone = fitted(1)
        torch.set_num_threads(3)
        together = fitted(3)
    finally:
        torch.set_num_threads(threads)
    for one, other in zip(alone, together, strict=True):
        assert torch.equal(one[0], other[0]) and torch.equal(one[1], other[1]) and one[2] == other[2]


def test_views_are_compared_on_few_pixels_of_each(
    capture: tuple[Scene, Capture], monkeypatch: pytest.MonkeyPatch
) -> None:
    solver = solver_of(capture)
    all_pixels = solver._pixels.of(VIEWS).points.view.bincount()
    monkeypatch.setattr(photograph_pixels, "COMPARED_PIXELS", 100)
    few = solver._pixels.compared(VIEWS)
    counts = few.points.view.bincount()
    assert (
        len(counts) == len(VIEWS) and all(50 <= int(count) <= 100 for count in counts) and int(all_pixels.min()) > 100
    )
    fit = solver.fit(DIRECT, None, VIEWS[:4], 1.0, silent)
    assert len(solver.errors(fit, VIEWS[4:])) == 2


def test_only_the_last_pixels_stay_in_memory(capture: tuple[Scene, Capture]) -> None:
    solver = solver_of(capture)
    whole = solver._pixels.recent(VIEWS, 1.0, DIRECT)
    assert solver._pixels.recent(VIEWS, 1.0, DIRECT) is whole
    solver._pixels._max_recent_pixels = len(whole)
    half = solver._pixels.recent(VIEWS, 0.5, DIRECT)
    assert solver._pixels.recent(VIEWS, 0.5, DIRECT) is half and list(solver._pixels._recent) == [(tuple(VIEWS), 0.5)]
    solver._pixels._max_recent_pixels = 1
    camera = ModelSpec(light_frame="camera")
    solver.fit(camera, None, VIEWS, 0.1, silent)
    assert all(not pixels.irradiance for pixels in solver._pixels._recent.values()), "too many to keep their matrices"


def test_a_share_of_the_pixels_is_a_part_of_them(capture: tuple[Scene, Capture]) -> None:
    solver = solver_of(capture)
    photographs = solver._pixels.of(VIEWS)
    few, half = (solver._pixels.subsampled(photographs, share) for share in (0.1, 0.5))
    rows = {tuple(pixel) for pixel in half.pixel.tolist()}
    assert all(tuple(pixel) in rows for pixel in few.pixel.tolist()), "a larger budget keeps the pixels it had"
    assert len(few) == pytest.approx(0.1 * len(photographs), rel=0.3)
    assert solver._pixels.subsampled(photographs, 1.0) is photographs


def test_a_dielectric_reflects_no_more_than_a_gem(monkeypatch: pytest.MonkeyPatch) -> None:
    """Photographs of a metal: what a dielectric with the F0 of a metal would explain is left to the metal."""
    mesh = unwrap_mesh(bowl(), TEXELS)[0]
    metal = Material.metallic(torch.tensor([0.9, 0.9, 0.9]), torch.ones(1), torch.tensor([0.2]))
    grey = make_material(torch.full((TEXELS, TEXELS, 3), 0.5), 0.15, 0.2, "dielectric")
    seen = photographs(Scene(mesh, metal, lamps()), around(len(VIEWS)))
    options = replace(OPTIONS, steps=60)
    spec = ModelSpec("dielectric", "uniform", light_is_known=True)

    def fitted_f0() -> float:
        solver = TransportGGX(options).prepare(Scene(mesh, grey, lamps()), seen)
        return float(solver.fit(spec, None, VIEWS, 1.0, silent).parameters.specular_albedo.max())

    assert fitted_f0() == pytest.approx(MAX_FITTED_F0, abs=1e-4)
    monkeypatch.setattr(joint_optimization, "MAX_FITTED_F0", 0.9)
    assert fitted_f0() > 1.2 * MAX_FITTED_F0, "the photographs ask for more"
