"""A mesh is revised after the material is known, and the revised one is kept where held-out views gain."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from hir_core.capture import Capture
from hir_core.capture.photograph_exposures import EQUAL_EXPOSURES
from hir_core.config import RunConfig
from hir_core.plugins import Component, hookimpl
from hir_core.plugins.interfaces import Initializer
from hir_core.plugins.manager import PluginManager
from hir_core.plugins.progress import Progress
from hir_core.run.stage_context import StageContext
from hir_core.scene import EnvironmentMap, Material, Scene
from hir_core.stages import shape_revision
from hir_core.stages.geometry.geometry_fit import FittedGeometry
from hir_core.stages.reflectance.reflectance_fit import FittedReflectance
from hir_core.stages.reflectance.reflectance_report import LightAndMaterial, ReflectanceReport
from hir_core.testing.captures import surface_mesh

FIRST = np.array([1e-3, 2e-3, 1e-3, 2e-3, 1e-3, 2e-3])


@dataclass(frozen=True)
class Options:
    changes: bool = True


class Reviser(Initializer):
    """Moves the vertices of a fitted scene, or leaves them."""

    def __init__(self, config: Options) -> None:
        self.changes = config.changes

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        assert scene is not None and scene.material is not None and scene.environment is not None
        assert workspace.is_dir()
        warnings.warn("the opening is dark; add a lamp", UserWarning, stacklevel=1)
        if not self.changes:
            return capture, scene
        return capture, Scene(scene.mesh.with_positions(0.9 * scene.mesh.positions))

    def report(self) -> Mapping[str, Any]:
        return {"moved": self.changes}


def reviser(traits: frozenset[str] = frozenset({"needs_surface", "makes_surface", "revises_mesh"})) -> Component:
    return Component("reviser", f"{__name__}:Reviser", Options, "Moves vertices.", traits=traits)


@dataclass(frozen=True)
class Plugin:
    component: Component

    @hookimpl
    def hir_register_initializers(self) -> list[Component]:
        return [self.component]


@dataclass
class Fits:
    """Stands for the fits of geometry, atlas, material and light; records what they were given."""

    held_out: list[np.ndarray | None]
    scenes: list[Scene] = field(default_factory=list)
    workspaces: list[Path] = field(default_factory=list)

    def reflectance(
        self, scene: Scene, capture: Capture, settings: Any, context: StageContext, silhouettes: Any = None
    ) -> FittedReflectance:
        self.scenes.append(scene)
        self.workspaces.append(context.workspace)
        context.warn(f"warning of fit {len(self.scenes)}; look at it")
        context.report(Progress("reflectance", 5, 10, 1.0, {"held_out_psnr": np.ones(1)}, "metal", milestone="fitted"))
        material = Material("dielectric", torch.full((3,), 0.3), torch.full((3,), 0.04), torch.ones(1))
        fitted = replace(scene, material=material, environment=EnvironmentMap(torch.ones(4, 8, 3)))
        report = ReflectanceReport("solver", f"fit {len(self.scenes)}", "world", LightAndMaterial.of(fitted))
        return FittedReflectance(fitted, EQUAL_EXPOSURES, None, report, self.held_out[len(self.scenes) - 1])

    def geometry(self, scene: Scene, capture: Capture, settings: Any, context: StageContext) -> Any:
        assert scene.material is None and scene.environment is None
        context.report(Progress("geometry", 1, 2, 0.5))
        return FittedGeometry(scene), None

    def unwrap(self, scene: Scene, capture: Capture, settings: Any, context: StageContext) -> Any:
        return scene, None


@dataclass
class Outcome:
    found: FittedReflectance
    fits: Fits
    warnings: list[str]
    progress: list[Progress]

    @property
    def revision(self) -> dict[str, Any] | None:
        return self.found.report.as_document().get("revision")


Run = Callable[..., Outcome]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    def revised(
        *held_out: np.ndarray | None,
        changes: bool = True,
        component: Component | None = None,
        **settings: Any,
    ) -> Outcome:
        fits = Fits(list(held_out))
        for name, stand_in in (
            ("fit_reflectance", fits.reflectance),
            ("fit_geometry", fits.geometry),
            ("unwrap", fits.unwrap),
        ):
            monkeypatch.setattr(shape_revision, name, stand_in)
        plugins = PluginManager()
        plugins.register(Plugin(component or reviser()), "tests", "0")
        config = RunConfig(initializers=("reviser",), initializer={"reviser": {"changes": changes}})
        for stage, values in settings.items():
            config = replace(config, **{stage: replace(getattr(config, stage), **values)})
        warned: list[str] = []
        shown: list[Progress] = []
        context = StageContext(plugins, tmp_path, report=shown.append, warn=warned.append)
        capture = Capture(Path("made-in-memory"), ())
        found = shape_revision.fit_reflectance_and_revise(surface_mesh(16), capture, config, context)
        return Outcome(found, fits, warned, shown)

    return revised


@pytest.mark.parametrize(("factor", "accepted"), [(0.5, True), (2.0, False)])
def test_held_out_views_decide_between_both_meshes(run: Run, factor: float, accepted: bool) -> None:
    outcome = run(FIRST, factor * FIRST)
    first, second = outcome.fits.scenes
    assert torch.allclose(second.mesh.positions, 0.9 * first.mesh.positions)
    assert outcome.found.scene.mesh is (second if accepted else first).mesh
    assert outcome.found.report.model == f"fit {1 + accepted}"
    revision = outcome.revision
    assert revision is not None and revision["details"] == {"reviser": {"moved": True}}
    assert revision["accepted"] is accepted and revision["held_out_views"] == 6 and not revision["near_tie"]
    assert revision["gain_db"] == pytest.approx(3.01 if accepted else -3.01, abs=0.01)
    assert f"held-out views {'gain' if accepted else 'lose'} 3.0 ±" in revision["sentence"]
    assert f"warning of fit {1 + accepted}; look at it" in outcome.warnings
    assert f"warning of fit {2 - accepted}; look at it" not in outcome.warnings
    assert "the opening is dark; add a lamp" in outcome.warnings


def test_the_second_fit_has_checkpoints_of_its_own_and_one_progress_bar(run: Run) -> None:
    outcome = run(FIRST, FIRST)
    first, second = outcome.fits.workspaces
    assert second != first and (first / "checkpoints") in second.parents, "removed with the stage's own"
    assert {each.stage for each in outcome.progress} == {"reflectance"}
    curves = [each for each in outcome.progress if each.scalars or each.milestone]
    assert len(curves) == 1 and curves[0].message == "metal", "the curves are those of the first fit"
    named = {each.message for each in outcome.progress}
    assert {f"revised mesh: {step}" for step in ("geometry", "atlas", "material and light")} <= named


def test_an_unchanged_mesh_is_fitted_once(run: Run) -> None:
    outcome = run(FIRST, changes=False)
    assert len(outcome.fits.scenes) == 1
    assert outcome.revision == {"initializers": ("reviser",), "details": {"reviser": {"moved": False}}} | {
        "changed": False,
        "accepted": False,
        "sentence": "",
    }
    assert "warning of fit 1; look at it" in outcome.warnings


@pytest.mark.parametrize(
    "case",
    [
        {"reflectance": {"revise_mesh": False}},
        {"geometry": {"enabled": False}},
        {"component": reviser(frozenset({"makes_surface"}))},
        {"held_out": None},
    ],
    ids=["setting", "no geometry stage", "no trait", "no held-out views"],
)
def test_initializers_are_not_asked(run: Run, case: dict[str, Any]) -> None:
    held_out = case.pop("held_out", FIRST)
    outcome = run(held_out, **case)
    assert len(outcome.fits.scenes) == 1 and outcome.revision is None
    assert outcome.warnings == ["warning of fit 1; look at it"]
