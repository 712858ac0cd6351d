"""Per-texel BRDFs: a ball of matt and metallic threads, photographed from many sides."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from hir_core.capture import Capture
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import Material, Scene
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.renderer import TransportGGX
from hir_plugins.reflectance_renderers.transport_ggx.textures.brdf_fit_state import PointBrdfs
from tests.fixtures.made_captures import (
    TEXELS,
    around,
    ball,
    fitted,
    lamps,
    make_material,
    painted,
    photographs,
    unseen_db,
)


def brocade(frequency: float = 9.0, texels: int = TEXELS) -> Scene:
    """A matt and a metallic thread in turn, in columns of π over `frequency`; the ball's radius is 1."""
    mesh = ball(texels)

    def threads(metal: tuple[float, ...], matt: tuple[float, ...]) -> Tensor:
        def color(place: Tensor) -> Tensor:
            is_metal = (torch.sin(frequency * place[:, :2]).prod(dim=1, keepdim=True) > 0).float()
            return is_metal * torch.tensor(metal) + (1 - is_metal) * torch.tensor(matt)

        return painted(mesh, color, texels)[0]

    diffuse, specular = threads((0.02, 0.02, 0.02), (0.3, 0.5, 0.2)), threads((0.6, 0.5, 0.2), (0.03, 0.03, 0.03))
    return Scene(mesh, make_material(diffuse, specular, threads((0.3,), (0.6,)), "dielectric"), lamps())


@pytest.mark.slow
def test_threads_of_two_materials_are_separated(tmp_path: Path) -> None:
    """Under a known light, from unseen sides; one BRDF for the whole surface is some decibels worse."""
    truth = brocade()
    capture = photographs(truth, around(24), size=64)
    one, own = (
        fitted(
            truth.mesh,
            capture,
            tmp_path / model,
            light=lamps(),
            brdf="dielectric",
            model=model,
            options={"vertices": 2000},
        )
        for model in ("specular", "per_texel_brdf")
    )
    material, report = own[0].material, own[1]
    assert material is not None and material.normal is not None and material.observed is not None
    assert material.specular_albedo.shape == (TEXELS, TEXELS, 3) and material.roughness.shape == (TEXELS, TEXELS, 1)
    assert report.model == "dielectric, specular, per-texel BRDF" and report.solver["observed"] > 0.8
    assert torch.isfinite(material.normal).all()
    assert unseen_db(own[0], truth) > unseen_db(one[0], truth) + 2
    known = material.observed
    metal = truth.material.specular_albedo[known][:, 0] > 0.5  # type: ignore[union-attr]
    found = material.specular_albedo[known][:, 0]
    assert float(found[metal].median()) > 4 * float(found[~metal].median())


@pytest.mark.slow
def test_model_selection_finds_threads_that_are_finer_than_vertices(tmp_path: Path) -> None:
    """Under a light that is not known; maps at vertices .15 apart gain nothing from columns of .22."""
    truth = brocade(14.0, 128)
    scene, report = fitted(truth.mesh, photographs(truth, around(32), size=96), tmp_path, texels=128, brdf="dielectric")
    assert report.model == "dielectric, specular, per-texel BRDF"
    assert scene.material is not None and scene.material.normal is not None
    assert unseen_db(scene, truth) > 39  # 41.0 measured


@pytest.mark.slow
def test_few_or_black_photographs_give_physical_values(tmp_path: Path) -> None:
    """Three views, one of them black: texels with too few photographs are inpainted, all values are physical."""
    truth = brocade()
    seen = photographs(truth, around(3), size=32)
    black = seen.views[1]
    pixels = black.pixels()
    dark = type(pixels)(np.zeros_like(pixels.color_linear), pixels.mask, pixels.saturated)
    views = (seen.views[0], type(black)(black.name, black.camera, lambda: dark), seen.views[2])
    few = {"steps": 60, "cache_cells": 200}
    capture = Capture(Path("made"), views)
    scene, report = fitted(truth.mesh, capture, tmp_path, options=few, brdf="dielectric", model="per_texel_brdf")
    assert report.solver["observed"] < 0.5
    assert scene.material is not None and scene.material.normal is not None
    assert torch.isfinite(scene.material.normal).all()


def test_held_out_pixels_are_shaded_as_textures_are() -> None:
    """A per-texel BRDF is compared by its textures' shading: of one BRDF everywhere both renderings are the same."""
    truth = brocade()
    capture = photographs(truth, around(5), size=32)
    options = TransportGGXOptions(vertices=0, cache_cells=200, samples=6, steps=1)
    solver = TransportGGX(options).prepare(truth, capture)
    spec = ModelSpec("dielectric", "uniform", light_is_known=True, per_texel="brdf")
    fit = solver.fit(spec, None, range(4), 0.1, lambda share: None)
    pixels = solver._pixels.compared([4])
    albedo, specular, alpha = torch.tensor([0.4, 0.3, 0.2]), torch.tensor([0.05, 0.06, 0.07]), torch.tensor([0.3])
    material = Material("dielectric", albedo, specular, alpha)
    count = len(pixels)
    normals, metalness = torch.zeros(count, 3), torch.zeros(count, 1)
    values = PointBrdfs(*(each.expand(count, -1) for each in (albedo, specular, alpha)), normals, metalness)
    _, shown = solver._shaded(fit, pixels, values, draw=0)
    expected = solver.radiance(material, lamps(), pixels.pixel)
    assert torch.allclose(shown, expected, atol=1e-4, rtol=1e-3) and float(expected.max()) > 0.1
    _, other = solver._shaded(fit, pixels, values, draw=1)
    assert not torch.equal(other, shown)


def test_held_out_pixels_are_shown_under_the_light_of_textures() -> None:
    """Textures with per-texel BRDFs get a light that is fitted again, and so does their comparison."""
    truth = brocade()
    options = TransportGGXOptions(vertices=0, cache_cells=200, samples=6, steps=1)
    solver = TransportGGX(options).prepare(truth, photographs(truth, around(6), size=32))
    spec = ModelSpec("dielectric", "uniform", light_is_known=True, per_texel="brdf")
    known = solver.fit(spec, None, range(5), 0.1, lambda share: None)
    assert solver._lit_at_texels(known) is solver._lit(known)
    ramp = torch.linspace(-1, 1, known.parameters.light.shape[1])[None, :, None]
    wrong = replace(known, parameters=replace(known.parameters, light=known.parameters.light + ramp))
    refitted = replace(wrong, spec=replace(spec, light_is_known=False))
    true, left, again = (float(solver.errors(fit, [5])[0]) for fit in (known, wrong, refitted))
    assert again - true < 0.5 * (left - true)
    assert solver._lit_at_texels(refitted) is solver._lit_at_texels(refitted), "it is fitted once"
