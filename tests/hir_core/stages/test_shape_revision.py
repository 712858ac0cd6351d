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
from hir_core.plugins.model_spec import ModelSpec
from hir_core.plugins.progress import Progress
from hir_core.run.stage_context import StageContext
from hir_core.scene import EnvironmentMap, Material, Scene
from hir_core.stages import shape_revision, unchanged_mesh
from hir_core.stages.geometry.geometry_fit import FittedGeometry
from hir_core.stages.reflectance.reflectance_fit import FittedReflectance
from hir_core.stages.reflectance.reflectance_report import LightAndMaterial, ReflectanceReport
from hir_core.stages.reflectance.selection.folded_fits import FoldedFit
from hir_core.stages.reflectance.selection.shape_selection import OtherMeshSelectedError, ShapeComparison
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
        assert scene is not None and workspace.is_dir()
        warnings.warn("the opening is dark; add a lamp", UserWarning, stacklevel=1)
        if not self.changes:
            return capture, scene
        return capture, Scene(scene.mesh.with_positions(0.9 * scene.mesh.positions))

    def report(self) -> Mapping[str, Any]:
        return {"moved": self.changes}


class Lifts(Initializer):
    """Moves the vertices up."""

    def __init__(self, _: object) -> None:
        pass

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        assert scene is not None and workspace.is_dir()
        warnings.warn("lifted; take it", UserWarning, stacklevel=1)
        return capture, Scene(scene.mesh.with_positions(scene.mesh.positions + 0.25))


def reviser(traits: frozenset[str] = frozenset({"needs_surface", "makes_surface", "revises_mesh"})) -> Component:
    return Component("reviser", f"{__name__}:Reviser", Options, "Moves vertices.", traits=traits)


@dataclass(frozen=True)
class Plugin:
    component: Component

    @hookimpl
    def hir_register_initializers(self) -> list[Component]:
        return [
            self.component,
            Component("lifts", f"{__name__}:Lifts", summary="Lifts."),
            Component("hull", f"{__name__}:Lifts", summary="Never asked."),
        ]


@dataclass
class Fits:
    """Stands for the fits of geometry, atlas, material and light; records what they were given."""

    held_out: list[np.ndarray | None]
    scenes: list[Scene] = field(default_factory=list)
    workspaces: list[Path] = field(default_factory=list)
    others: list[Scene] = field(default_factory=list)
    """Unchanged meshes that the fits were given."""
    settings: list[Any] = field(default_factory=list)
    """Of the geometry fits."""

    other: ShapeComparison[Any] | None = None
    """With the unchanged mesh, of the first fit."""

    def reflectance(
        self,
        scene: Scene,
        capture: Capture,
        settings: Any,
        context: StageContext,
        silhouettes: Any = None,
        other_scene: Callable[[], Scene] | None = None,
    ) -> FittedReflectance:
        self.scenes.append(scene)
        self.workspaces.append(context.workspace)
        context.warn(f"warning of fit {len(self.scenes)}; look at it")
        context.report(Progress("reflectance", 5, 10, 1.0, {"held_out_psnr": np.ones(1)}, "metal", milestone="fitted"))
        material = Material("dielectric", torch.full((3,), 0.3), torch.full((3,), 0.04), torch.ones(1))
        fitted = replace(scene, material=material, environment=EnvironmentMap(torch.ones(4, 8, 3)))
        if other_scene is not None:
            assert self.other is not None
            self.others.append(other_scene())
            if self.other.accepted:
                raise OtherMeshSelectedError(self.other)
        report = ReflectanceReport("solver", f"fit {len(self.scenes)}", "world", LightAndMaterial.of(fitted))
        held_out = self.held_out[len(self.scenes) - 1]
        return FittedReflectance(fitted, EQUAL_EXPOSURES, None, report, held_out, self.other if other_scene else None)

    def geometry(self, scene: Scene, capture: Capture, settings: Any, context: StageContext) -> Any:
        assert scene.material is None and scene.environment is None
        self.settings.append(settings)
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
        other: ShapeComparison[Any] | None = None,
        **settings: Any,
    ) -> Outcome:
        fits = Fits(list(held_out), other=other)
        for name, stand_in in (
            ("fit_reflectance", fits.reflectance),
            ("fit_geometry", fits.geometry),
            ("unwrap", fits.unwrap),
        ):
            for module in (shape_revision, unchanged_mesh):
                monkeypatch.setattr(module, name, stand_in, raising=False)
        plugins = PluginManager()
        plugins.register(Plugin(component or reviser()), "tests", "0")
        options = {"reviser": {"changes": changes}}
        config = RunConfig(initializers=("hull", "reviser", "lifts"), initializer=options)
        for stage, values in settings.items():
            config = replace(config, **{stage: replace(getattr(config, stage), **values)})
        warned: list[str] = []
        shown: list[Progress] = []
        context = StageContext(plugins, tmp_path, report=shown.append, warn=warned.append)
        capture = Capture(Path("made-in-memory"), ())
        unchanged = None if other is None else surface_mesh(12)
        found = shape_revision.fit_reflectance_and_revise(
            surface_mesh(16), capture, config, context, unchanged_scene=unchanged
        )
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


def comparison(gain_db: float, accepted: bool) -> ShapeComparison[Any]:
    spec = ModelSpec("dielectric")
    fit: FoldedFit[Any] = FoldedFit(spec, (), FIRST, FIRST)
    return ShapeComparison(fit, (20.0, 21.0), gain_db, 0.5, accepted)


@pytest.mark.parametrize("selected", [True, False])
def test_held_out_views_decide_whether_a_change_of_the_mesh_is_kept(run: Run, selected: bool) -> None:
    """Without it the other initializers run on the mesh before it, and outlines alone are enough for the comparison."""
    outcome = run(FIRST, FIRST, changes=False, other=comparison(2.0 if selected else -2.0, selected))
    unchanged = surface_mesh(12).mesh.positions + 0.25
    assert [torch.equal(scene.mesh.positions, unchanged) for scene in outcome.fits.others] == [True]
    assert [each.photo_consistency for each in outcome.fits.settings] == ["off", "auto"][: 1 + selected]
    assert len(outcome.fits.scenes) == 1 + selected
    assert torch.equal(outcome.found.scene.mesh.positions, unchanged) == selected
    kept = [f"warning of fit {1 + selected}; look at it"]
    assert [each for each in outcome.warnings if "dark" not in each] == kept, "not those of the mesh that is left"
    report = outcome.found.report.as_document()["unchanged_mesh"]
    assert report["selected"] is selected and report["initializers"] == ("reviser",)
    assert report["held_out_views"] == 6 and report["gain_db"] == (2.0 if selected else -2.0)
    named = {each.message for each in outcome.progress}
    assert {f"unchanged mesh: {step}" for step in ("lifts", "geometry", "atlas")} <= named
    first, *second = outcome.fits.workspaces
    assert all((first / "checkpoints") in each.parents for each in second), "removed with the stage's own"


@pytest.mark.parametrize("case", [{"reflectance": {"revise_mesh": False}}, {"geometry": {"enabled": False}}])
def test_the_settings_keep_a_change_of_the_mesh(run: Run, case: dict[str, Any]) -> None:
    outcome = run(FIRST, other=comparison(2.0, True), **case)
    assert not outcome.fits.others and len(outcome.fits.scenes) == 1
    assert "unchanged_mesh" not in outcome.found.report.as_document()


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
