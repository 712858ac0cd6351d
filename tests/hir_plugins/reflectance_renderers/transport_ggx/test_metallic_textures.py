"""Textures of fitted metals: per-texel equations and BRDFs, path-traced refinement, checkpoints, extremes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hir_exporters import create_exporter
from hir_exporters.reading.gltf_readback import read_gltf

from hir_core.capture import Capture
from hir_core.plugins.interfaces import CheckpointLocation
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import EnvironmentMap, Material, Scene
from hir_core.scene.asset_conversion import bake
from hir_core.scene.srgb import linear_to_srgb
from hir_core.stages.reflectance.selection.held_out_comparison import mean_decibels, paired_gain
from hir_plugins.reflectance_renderers.mitsuba_ggx.options import MitsubaGGXOptions
from hir_plugins.reflectance_renderers.mitsuba_ggx.renderer import MitsubaGGX
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.renderer import TransportGGX
from hir_plugins.reflectance_renderers.transport_ggx.solver import TransportSolver
from tests.fixtures.made_captures import TEXELS, around, ball, fitted, lamps, painted, photographs

VIEWS = range(6)
OPTIONS = TransportGGXOptions(vertices=0, cache_cells=200, samples=6, steps=60)
METAL = ModelSpec("metallic", "uniform", metalness="metal", light_is_known=True)
MIXED = replace(METAL, metalness="map")
GOLD = torch.tensor([0.9, 0.6, 0.25])
BLUE = torch.tensor([0.1, 0.2, 0.5])


def silent(share: float) -> None:
    """Ignores the progress."""


def solver_of(truth: Scene, capture: Capture) -> TransportSolver:
    grey = Material("dielectric", torch.full((TEXELS, TEXELS, 3), 0.5), torch.full((3,), 0.04), torch.tensor([0.1]))
    return TransportGGX(OPTIONS).prepare(replace(truth, material=grey), capture)


def metal_ball(base: torch.Tensor, light: EnvironmentMap, metalness: float = 1.0, alpha: float = 0.3) -> Scene:
    return Scene(ball(), Material.metallic(base, torch.tensor([metalness]), torch.tensor([alpha])), light)


@pytest.fixture(scope="module")
def half_gold() -> tuple[Scene, Capture]:
    """A ball, gold on the right and blue plastic on the left, under lamps, and its photographs."""
    mesh = ball()
    base, _ = painted(mesh, lambda p: torch.where(p[:, :1] > 0, GOLD, BLUE))
    metal, _ = painted(mesh, lambda p: (p[:, :1] > 0).float())
    truth = Scene(mesh, Material.metallic(base, metal, torch.tensor([0.25])), lamps())
    return truth, photographs(truth, around(len(VIEWS)))


def error_of(material: Material, truth: Material) -> float:
    """Mean error of the base colour over observed texels."""
    assert material.observed is not None
    return float((material.base_color - truth.base_color).expand(TEXELS, TEXELS, 3)[material.observed].abs().mean())


def test_path_tracing_corrects_the_base_colour(half_gold: tuple[Scene, Capture]) -> None:
    """From a base colour that is a fifth too dark, under the true metalness, α and light."""
    truth, capture = half_gold
    assert truth.material is not None
    solver = solver_of(truth, capture)
    solved = solver.scene(solver.fit(MIXED, None, VIEWS, 0.2, silent), VIEWS, silent)
    assert solved.scene.material is not None and truth.material.metalness is not None
    observed = solved.scene.material.observed
    true = truth.material
    dark = Material.metallic(0.8 * true.base_color, truth.material.metalness, true.roughness, None, observed)
    wrong = replace(solved, scene=replace(solved.scene, material=dark))
    tracer = MitsubaGGX(MitsubaGGXOptions(samples=64, max_depth=2)).prepare(wrong.scene, capture)
    refined = solver.refine(wrong, tracer, VIEWS, silent)
    assert refined is not None and refined.scene.material is not None
    found = refined.scene.material
    assert found.model == "metallic" and torch.equal(found.metalness, truth.material.metalness)
    assert error_of(found, true) < 0.5 * error_of(dark, true)


@pytest.mark.parametrize("spec", [METAL, MIXED], ids=["metal", "mixed"])
def test_per_texel_brdfs_of_a_metallic_model(half_gold: tuple[Scene, Capture], spec: ModelSpec) -> None:
    """Maps of base colour, metalness and α that bake to an asset; held-out errors are finite."""
    solver = solver_of(*half_gold)
    fit = solver.fit(replace(spec, per_texel="brdf"), None, VIEWS[:5], 0.5, silent)
    control = replace(fit, spec=replace(spec, per_texel="albedo"))
    assert solver.errors(fit, [5])[0] < 0.01 and solver.errors(control, [5])[0] < 0.02
    scene = solver.scene(fit, VIEWS, silent).scene
    material = scene.material
    assert material is not None and material.model == "metallic" and material.metalness is not None
    assert material.roughness.shape == (TEXELS, TEXELS, 1)
    assert material.metalness.shape == ((1,) if spec is METAL else (TEXELS, TEXELS, 1))
    for value in (material.base_color, material.metalness, material.roughness):
        assert bool(torch.isfinite(value).all()) and float(value.min()) >= -1e-6 and float(value.max()) <= 1 + 1e-6
    asset = bake(scene)
    assert asset.material.metalness is not None


def test_a_finished_fit_of_metal_is_read_from_its_checkpoint(half_gold: tuple[Scene, Capture], tmp_path: Path) -> None:
    """Metalness included, and the fit of metal that a mixed one starts from."""
    location = CheckpointLocation(tmp_path / "fit_1", 0.0)
    fit = solver_of(*half_gold).fit(MIXED, None, VIEWS, 0.1, silent, location)
    assert {path.name for path in tmp_path.iterdir()} == {"fit_1.npz", "fit_1_metal.npz"}
    again = solver_of(*half_gold).fit(MIXED, None, VIEWS, 0.1, silent, location)
    assert again.parameters.metalness is not None and fit.parameters.metalness is not None
    assert torch.equal(again.parameters.metalness, fit.parameters.metalness)
    metal = solver_of(*half_gold).fit(METAL, None, VIEWS, 0.1, silent, location.part("metal"))
    assert metal.parameters.is_metal


@pytest.mark.parametrize("brightness", [0.0, 1.0, 40.0], ids=["black metal", "white metal", "clipped highlights"])
def test_extreme_metals(brightness: float) -> None:
    """Black, white, and under lamps that clip most of the photographs: values stay physical, colours are near."""
    base = torch.full((3,), min(brightness, 0.95))
    light = lamps() if brightness <= 1 else EnvironmentMap(lamps().radiance * 4)
    truth = metal_ball(base, light)
    capture = photographs(truth, around(len(VIEWS)))
    if brightness > 1:
        assert max(float(view.pixels().saturated.mean()) for view in capture.views) > 0.1
    solver = solver_of(truth, capture)
    material = solver.scene(solver.fit(METAL, None, VIEWS, 1.0, silent), VIEWS, silent).scene.material
    assert material is not None and material.observed is not None
    assert bool(torch.isfinite(material.base_color).all() & torch.isfinite(material.roughness).all())
    assert float((material.base_color[material.observed] - base).abs().mean()) < 0.1


def test_one_view_of_a_metal() -> None:
    truth = metal_ball(GOLD, lamps())
    solver = solver_of(truth, photographs(truth, around(1)))
    spec = replace(MIXED, light_is_known=False)
    material = solver.scene(solver.fit(spec, None, [0], 0.5, silent), [0], silent).scene.material
    assert material is not None and material.metalness is not None
    for value in (material.base_color, material.metalness, material.roughness):
        assert bool(torch.isfinite(value).all()) and float(value.min()) >= 0 and float(value.max()) <= 1


def test_a_plastic_is_not_taken_for_metal() -> None:
    """On views left out the dielectric is far ahead of metal, and of both together; its colour is the plastic's."""
    truth = metal_ball(BLUE, lamps(), 0.0, 0.3)
    solver = solver_of(truth, photographs(truth, around(12)))
    training, held_out = range(0, 12, 2), range(1, 12, 2)
    fits = {
        spec.kind: solver.fit(spec, None, training, 1.0, silent)
        for spec in (replace(METAL, brdf="dielectric", metalness="none"), METAL, MIXED)
    }
    errors = {kind: solver.errors(fit, held_out) for kind, fit in fits.items()}
    for kind in ("metal", "mixed"):
        gain, standard_error = paired_gain(errors[kind], errors["dielectric"])
        assert gain > 8 and gain > 4 * standard_error  # metal 20 dB, both together 10 dB
    assert mean_decibels(errors["dielectric"]) > 42
    assert float((fits["dielectric"].scene_parameters.base_color - BLUE).abs().mean()) < 0.015


@pytest.mark.slow
def test_a_forced_metallic_fit_ends_in_a_glb(half_gold: tuple[Scene, Capture], tmp_path: Path) -> None:
    """The whole stage by its settings, refinement included, then bake and export: the file has the fitted maps."""
    truth, capture = half_gold
    options = {"steps": 60, "cache_cells": 200}
    scene, report = fitted(
        truth.mesh, capture, tmp_path, light=lamps(), brdf="metallic", model="specular", options=options
    )
    assert report.model == "metal and dielectric" and report.comparisons == ()
    assert scene.material is not None and scene.material.model == "metallic"
    asset = bake(scene)
    path = tmp_path / "half_gold.glb"
    create_exporter("glb").write(asset, path)
    back = read_gltf(path).surface
    assert asset.material.metalness is not None
    assert float(np.abs(back.metallic - asset.material.metalness).max()) <= 1 / 255
    assert float(np.abs(back.roughness - np.sqrt(asset.material.roughness)).max()) <= 1 / 255
    srgb = linear_to_srgb(torch.from_numpy(back.base_color)) - linear_to_srgb(
        torch.from_numpy(asset.material.base_color)
    )
    assert float(srgb.abs().max()) <= 1 / 255, "eight bits"
