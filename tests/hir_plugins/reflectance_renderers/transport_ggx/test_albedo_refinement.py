"""Path-traced albedo refinement is accepted where held-out views gain, and rejected where they do not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
import torch

from hir_core.capture import Capture
from hir_core.plugins.interfaces import PreparedReflectance, ReflectanceSolver, Solved
from hir_core.run.stage_context import StageContext
from hir_core.scene import Scene
from hir_core.stages.atlas import unwrap_mesh
from hir_core.stages.reflectance.path_traced_refinement import refine_albedo
from hir_core.stages.reflectance.reflectance_report import RefinementReport
from hir_plugins.reflectance_renderers.transport_ggx.textures.albedo_refinement import AlbedoRefinement
from hir_plugins.reflectance_renderers.transport_ggx.textures.texel_equations import TexelEquations
from tests.fixtures.made_captures import (
    BROWN,
    PLUGINS,
    TEXELS,
    around,
    bowl,
    fitted,
    lamps,
    make_material,
    photographs,
    reflectance_settings,
    unseen_db,
)


def scripted(factor: float | None) -> ReflectanceSolver[Any, Any]:
    """A solver whose refinement multiplies the albedo by a factor."""

    def refine(solved: Solved[Any], traced: Any, views: Any, report: Callable[[float], None]) -> Solved[Any] | None:
        report(1.0)
        material = solved.scene.material
        if factor is None or material is None:
            return None
        if traced is None:
            return solved
        brighter = replace(material, diffuse_albedo=factor * material.diffuse_albedo)
        return replace(solved, scene=replace(solved.scene, material=brighter))

    return cast(ReflectanceSolver[Any, Any], SimpleNamespace(refine=refine))


@pytest.fixture(scope="module")
def shadowed() -> tuple[Scene, Capture]:
    """A bowl under lamps, and its photographs."""
    truth = Scene(unwrap_mesh(bowl(), TEXELS)[0], make_material(BROWN), lamps())
    return truth, photographs(truth, around(16))


def compared(
    scene: Scene, solver: ReflectanceSolver[Any, Any], capture: Capture, folder: Path
) -> tuple[Scene, RefinementReport]:
    """With direct light alone, as the photographs were rendered."""
    shares: list[float] = []
    solved: Solved[Any] = Solved(scene, cast(PreparedReflectance, None), None, {})
    context, settings = StageContext(PLUGINS, folder, {}), reflectance_settings()
    refined, report = refine_albedo(solved, solver, capture, settings, 0, context, shares.append)
    assert shares == sorted(shares) and shares[0] >= 0 and shares[-1] <= 1
    assert shares[-1] == 1 or not report.accepted
    return refined.scene, report


def test_a_better_albedo_is_accepted_and_a_worse_one_is_rejected(
    shadowed: tuple[Scene, Capture], tmp_path: Path
) -> None:
    truth, capture = shadowed
    assert truth.material is not None
    dark = replace(truth, material=replace(truth.material, diffuse_albedo=0.8 * truth.material.diffuse_albedo))
    better, report = compared(dark, scripted(1.25), capture, tmp_path)
    assert report.accepted and report.gain_db is not None and report.gain_db > 5 and better is not dark
    assert report.before_db is not None and report.after_db is not None and report.after_db > report.before_db
    same, report = compared(truth, scripted(0.8), capture, tmp_path)
    assert not report.accepted and report.gain_db is not None and report.gain_db < -5 and same is truth


def test_few_photographs_judge_in_two_folds(shadowed: tuple[Scene, Capture], tmp_path: Path) -> None:
    truth, capture = shadowed
    assert truth.material is not None
    dark = replace(truth, material=replace(truth.material, diffuse_albedo=0.8 * truth.material.diffuse_albedo))
    eight = Capture(capture.path, capture.views[::2])
    better, report = compared(dark, scripted(1.25), eight, tmp_path)
    assert report.accepted and report.held_out_views == 8 and not report.near_tie and better is not dark
    _, report = compared(truth, scripted(1.0), eight, tmp_path)
    assert not report.accepted and report.near_tie and report.gain_db == 0


def test_too_few_views_and_a_solver_without_refinement(shadowed: tuple[Scene, Capture], tmp_path: Path) -> None:
    truth, capture = shadowed
    few = Capture(capture.path, capture.views[:3])
    same, report = compared(truth, scripted(1.25), few, tmp_path)
    assert same is truth and report == RefinementReport(False, 0, "too few views")
    same, report = compared(truth, scripted(None), capture, tmp_path)
    assert same is truth and not report.accepted and "closed form" in str(report.not_compared)


def test_the_noise_of_the_path_tracer_depends_on_the_seed_of_the_run(shadowed: tuple[Scene, Capture]) -> None:
    scene, _ = shadowed
    assert scene.material is not None
    albedo, one = torch.full((4, 4, 3), 0.5), torch.ones(6, 3)
    index, weight = torch.arange(24).reshape(6, 4) % 16, torch.full((6, 4), 0.25)
    pixel, clipped = torch.zeros(6, 3, dtype=torch.int32), torch.zeros(6, 3, dtype=torch.bool)
    rows = TexelEquations(index, weight, one, one, 0 * one, one, clipped, pixel)
    traced = cast(PreparedReflectance, SimpleNamespace(radiance=lambda *_: torch.rand(6, 3)))

    def offset(seed: int) -> torch.Tensor:
        return AlbedoRefinement([rows], seed)._corrected(rows, scene, traced, albedo, None).offset

    assert torch.equal(offset(1), offset(1))
    assert not torch.equal(offset(1), offset(2))


@pytest.mark.parametrize(("cells", "accepted"), [(30, True), pytest.param(800, False, marks=pytest.mark.slow)])
def test_path_tracing_corrects_a_coarse_irradiance_cache(
    shadowed: tuple[Scene, Capture], tmp_path: Path, cells: int, accepted: bool
) -> None:
    """With thirty cells the irradiance in a bowl is coarse; the albedo compensates it until it is refined."""
    truth, capture = shadowed
    found = {}
    for refine in (False, True):
        scene, report = fitted(
            truth.mesh,
            capture,
            tmp_path / str(refine),
            light=lamps(),
            model="diffuse",
            path_tracing={"refine_albedo": refine},
            options={"cache_cells": cells},
        )
        found[refine] = unseen_db(scene, truth)
        assert scene.material is not None and bool(torch.isfinite(scene.material.diffuse_albedo).all())
        found_gain = report.albedo_refinement is not None and report.albedo_refinement.accepted
        assert found_gain == (refine and accepted)
    assert found[True] > found[False] + 4 if accepted else found[True] == found[False]
