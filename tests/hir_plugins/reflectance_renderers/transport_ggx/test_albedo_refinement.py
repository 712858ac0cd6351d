"""The last albedo: what path tracing asks for stays where held-out views gain by it, and goes where they do not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
import torch

from hir_core.capture import Capture
from hir_core.config import ReflectanceSettings
from hir_core.plugins.interfaces import ReflectanceSolver
from hir_core.run.stage_context import StageContext
from hir_core.scene import Scene
from hir_core.stages.atlas import unwrap_mesh
from hir_core.stages.reflectance.path_traced_refinement import settled
from tests.fixtures.made_captures import (
    BROWN,
    PLUGINS,
    TEXELS,
    around,
    bowl,
    fitted,
    lamps,
    look,
    photographs,
    unseen_db,
)


def scripted(factor: float | None) -> ReflectanceSolver:
    """A solver whose answer is the albedo times a factor."""

    def settle(scene: Scene, traced: Any, views: Any, report: Any) -> Scene | None:
        report(1.0)
        material = scene.material
        if factor is None or material is None:
            return None
        if traced is None:
            return scene
        return replace(scene, material=replace(material, diffuse_albedo=factor * material.diffuse_albedo))

    return cast(ReflectanceSolver, SimpleNamespace(settle=settle))


@pytest.fixture(scope="module")
def shadowed() -> tuple[Scene, Capture]:
    """A bowl under lamps, and its photographs."""
    truth = Scene(unwrap_mesh(bowl(), TEXELS)[0], look(BROWN), lamps())
    return truth, photographs(truth, around(16))


def judged(scene: Scene, solver: ReflectanceSolver, capture: Capture, folder: Path) -> tuple[Scene, dict[str, Any]]:
    """Of direct light alone, as the photographs were made."""
    shares: list[float] = []
    found = settled(scene, solver, capture, ReflectanceSettings(), 0, StageContext(PLUGINS, folder, {}), shares.append)
    assert shares == sorted(shares) and shares[0] >= 0 and shares[-1] <= 1
    assert shares[-1] == 1 or not found[1]["kept"]
    return found


def test_a_better_albedo_is_kept_and_a_worse_one_is_not(shadowed: tuple[Scene, Capture], tmp_path: Path) -> None:
    truth, capture = shadowed
    assert truth.material is not None
    dark = replace(truth, material=replace(truth.material, diffuse_albedo=0.8 * truth.material.diffuse_albedo))
    better, report = judged(dark, scripted(1.25), capture, tmp_path)
    assert report["kept"] and report["gain_db"] > 5 and report["after_db"] > report["before_db"] and better is not dark
    same, report = judged(truth, scripted(0.8), capture, tmp_path)
    assert not report["kept"] and report["gain_db"] < -5 and same is truth


def test_nothing_to_judge_by_and_nothing_to_judge(shadowed: tuple[Scene, Capture], tmp_path: Path) -> None:
    truth, capture = shadowed
    few = Capture(capture.path, capture.views[:3])
    same, report = judged(truth, scripted(1.25), few, tmp_path)
    assert same is truth and report == {"kept": False, "held_out_views": 0}
    same, report = judged(truth, scripted(None), capture, tmp_path)
    assert same is truth and not report["kept"] and "closed form" in report["reason"]


@pytest.mark.parametrize(("cells", "kept"), [(30, True), (800, False)])
def test_path_tracing_mends_what_few_cells_blur(
    shadowed: tuple[Scene, Capture], tmp_path: Path, cells: int, kept: bool
) -> None:
    """With thirty cells a bowl's shade is coarse, and its albedo takes that up until path tracing shows it."""
    truth, capture = shadowed
    found = {}
    for settle in (False, True):
        scene, report = fitted(
            truth.mesh,
            capture,
            tmp_path / str(settle),
            light=lamps(),
            model="diffuse",
            settle=settle,
            options={"cells": cells},
        )
        found[settle] = unseen_db(scene, truth)
        assert scene.material is not None and bool(torch.isfinite(scene.material.diffuse_albedo).all())
        assert report.get("settled", {}).get("kept", False) == (settle and kept)
    assert found[True] > found[False] + 4 if kept else found[True] == found[False]
