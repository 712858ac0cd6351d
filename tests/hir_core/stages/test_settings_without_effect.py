"""A setting that the user sets and that has no effect in the run is an error that names it and the remedy."""

from __future__ import annotations

from pathlib import Path
from typing import get_type_hints

import pytest

from hir_core.config import GradientSettings, PathTracingSettings, load_config
from hir_core.errors import ConfigError
from hir_core.pipeline import prepare, reconstruct
from hir_core.plugins.manager import PluginManager
from hir_core.run.run_directory import RunDirectory
from hir_core.stages.settings_without_effect import (
    check_settings_take_effect,
    settings_of_disabled_stages,
    settings_without_effect,
)
from tests.fixtures.made_captures import PLUGINS

GRADIENT = "reflectance.method=gradient"
MITSUBA = "reflectance.renderer=mitsuba_ggx"
TERM = "reflectance.regularizers.total_variation.weight=1"
KNOWN = "reflectance.known_environment=studio.hdr"
TRACED = "reflectance.path_tracing.iterations=5"
BY_VIEW = "reflectance.gradient.iterations_per_view=3"
VIEWS = "reflectance.gradient.batch=views"
DIFFUSE = "reflectance.model=diffuse"
NO_STEPS = "reflectance.gradient.iterations=0"
NO_REFINEMENT = "reflectance.path_tracing.refine_albedo=false"
HULL = 'initializers=["visual_hull"]'
T = "reflectance_renderer.transport_ggx."

WITHOUT_EFFECT = [
    ("geometry.iterations=7", ["geometry.iterations_per_view=3"], "iterations_per_view"),
    ("geometry.smoothness=7", ["geometry.parameterization=vertices"], "'large_steps'"),
    ("geometry.levels=2", ["geometry.remesh=false"], "geometry.remesh"),
    ("geometry.triangles=2000", ["geometry.remesh=false"], "geometry.remesh"),
    ("geometry.photo_consistency_iterations=7", ["geometry.photo_consistency=off"], "'auto'"),
    ("geometry.occlusion_boundary_iterations=7", ["geometry.photo_consistency=off"], "'auto'"),
    ("reflectance.gradient.iterations=7", [TERM], "method to 'gradient'"),
    ("reflectance.gradient.iterations_per_view=7", [TERM], "method to 'gradient'"),
    ("reflectance.gradient.learning_rate=0.5", [TERM], "method to 'gradient'"),
    ("reflectance.gradient.learning_rate=0.5", [TRACED], "method to 'gradient'"),
    ("reflectance.gradient.learning_rate_end=0.5", [TERM], "method to 'gradient'"),
    ("reflectance.gradient.batch=views", [TERM], "method to 'gradient'"),
    ("reflectance.gradient.batch_pixels=7", [], "path_tracing.iterations"),
    ("reflectance.gradient.rgb_weight=0.5", [], "path_tracing.iterations"),
    ("reflectance.gradient.loss_space=linear", [], "path_tracing.iterations"),
    ("reflectance.gradient.loss_space=linear", [TERM], "path_tracing.iterations"),
    ("reflectance.gradient.initial_diffuse_albedo=0.2", [], "'gradient'"),
    ("reflectance.gradient.initial_diffuse_albedo=0.2", [TERM], "'gradient'"),
    ("reflectance.gradient.iterations=7", [GRADIENT, BY_VIEW], "iterations_per_view"),
    ("reflectance.gradient.batch_pixels=7", [GRADIENT, VIEWS], "'pixels'"),
    ("reflectance.path_tracing.refine_albedo=false", [GRADIENT], "'auto'"),
    ("reflectance.path_tracing.iterations=7", [MITSUBA], "with a solver"),
    ("reflectance.path_tracing.learning_rate=0.5", [], "path_tracing.iterations"),
    ("reflectance.path_tracing.renderer=transport_ggx", [GRADIENT], "'auto'"),
    ("reflectance.path_tracing.renderer=transport_ggx", [NO_REFINEMENT], "refine_albedo"),
    ("reflectance.initial_radiance=0.2", [KNOWN], "known_environment"),
    ("reflectance.light_frame=camera", [KNOWN, GRADIENT], "known_environment"),
    ("reflectance.brdf=paper", [DIFFUSE], "reflectance.model"),
    ("reflectance.initial_roughness=0.2", [DIFFUSE], "reflectance.model"),
    ("reflectance.initial_specular_albedo=0.2", [DIFFUSE], "reflectance.model"),
    ("reflectance.revise_mesh=false", [GRADIENT], "with a solver"),
    ("reflectance.revise_mesh=false", [DIFFUSE], "reflectance.model"),
    ("reflectance.revise_mesh=false", ["geometry.enabled=false"], "geometry.enabled"),
    ("reflectance.revise_mesh=false", [HULL], "trait revises_mesh"),
    (f"{T}steps=7", [GRADIENT], "'auto'"),
    (f"{T}steps=7", [MITSUBA], "reflectance.renderer"),
    (f"{T}light_smoothness=1", [KNOWN], "known_environment"),
    (f"{T}initial_albedo=photographs", [KNOWN], "known_environment"),
    ("reflectance_renderer.mitsuba_ggx.samples=7", [NO_REFINEMENT], "reflectance.renderer"),
    ("initializer.camera_refinement.when=never", [HULL], 'initializers = ["visual_hull"] does not use'),
    ("initializer.fiducial_markers.side=0.02", [HULL], "name it there, or remove"),
    ("initializer.stereo.levels=1", [HULL, "reflectance.enabled=false"], "name it there, or remove"),
    ("mask_source.rembg.weights=a.onnx", [], 'masks = "auto" does not use rembg'),
    ("mask_source.folder.path=m", ['masks=["alpha"]'], 'masks = ["alpha"] does not use folder'),
    ("geometry_renderer.soft_silhouette.tile=8", [], 'geometry.renderer = "contour" does not use'),
    ("exporter.glb.profile=blender", ['export=["hdr"]'], 'export = ["hdr"] does not use glb'),
]

WITH_EFFECT = [
    ("reflectance.revise_mesh=false", []),
    ("reflectance.revise_mesh=false", ['initializers=["visual_hull", "hollows"]']),
    ("geometry.iterations=7", []),
    ("geometry.smoothness=7", []),
    ("geometry.levels=2", []),
    ("geometry.photo_consistency_iterations=7", []),
    ("geometry.occlusion_boundary_iterations=7", []),
    ("reflectance.gradient.iterations=7", [GRADIENT]),
    ("reflectance.gradient.iterations=7", [MITSUBA]),
    ("reflectance.gradient.iterations_per_view=7", [GRADIENT]),
    ("reflectance.gradient.learning_rate=0.5", [GRADIENT]),
    ("reflectance.gradient.batch=views", [GRADIENT]),
    ("reflectance.gradient.learning_rate_end=0.5", [GRADIENT]),
    ("reflectance.gradient.batch_pixels=7", [TRACED]),
    ("reflectance.gradient.batch_pixels=7", [TRACED, TERM, VIEWS]),
    ("reflectance.gradient.rgb_weight=0.5", [TRACED]),
    ("reflectance.gradient.loss_space=linear", [GRADIENT]),
    ("reflectance.gradient.initial_diffuse_albedo=0.2", [GRADIENT]),
    ("reflectance.path_tracing.refine_albedo=false", []),
    ("reflectance.path_tracing.iterations=7", []),
    ("reflectance.path_tracing.learning_rate=0.5", [TRACED]),
    ("reflectance.path_tracing.renderer=transport_ggx", []),
    (TERM, []),
    (TERM, [TRACED]),
    ("reflectance.initial_radiance=0.2", []),
    ("reflectance.light_frame=camera", []),
    ("reflectance.brdf=paper", []),
    ("reflectance.initial_roughness=0.2", [DIFFUSE, GRADIENT]),
    (f"{T}steps=7", []),
    (f"{T}samples=7", [GRADIENT]),
    (f"{T}light_smoothness=1", []),
    ("reflectance_renderer.mitsuba_ggx.samples=7", []),
    ("reflectance_renderer.mitsuba_ggx.samples=7", [MITSUBA]),
    ("initializer.visual_hull.max_resolution=40", [HULL]),
    ("initializer.stereo.levels=1", []),
    ("mask_source.folder.path=m", []),
    ("mask_source.rembg.weights=a.onnx", ['masks=["rembg"]']),
    ("geometry_renderer.contour.lines_per_pixel=2", []),
    ("exporter.glb.profile=blender", []),
]


@pytest.mark.parametrize(("setting", "others", "remedy"), WITHOUT_EFFECT, ids=str)
def test_a_setting_without_effect_is_an_error_with_its_remedy(setting: str, others: list[str], remedy: str) -> None:
    config = load_config(PLUGINS, "fast", assignments=[*others, setting])
    name = "reflectance.regularizers" if setting == TERM else setting.partition("=")[0]
    found = settings_without_effect(config, PLUGINS)
    assert list(found) == [name] and remedy in found[name]
    with pytest.raises(ConfigError, match=rf"{name} has no effect: "):
        check_settings_take_effect(config, PLUGINS)


@pytest.mark.parametrize(("setting", "others"), WITH_EFFECT, ids=str)
def test_a_setting_with_an_effect_is_accepted(setting: str, others: list[str]) -> None:
    config = load_config(PLUGINS, "fast", assignments=[*others, setting])
    assert setting.partition("=")[0] not in settings_without_effect(config, PLUGINS)


SOLVER = """
from hir_core.plugins import Component, hookimpl


@hookimpl
def hir_register_reflectance_renderers():
    return [Component("old_solver", "missing:Missing", traits=frozenset({"material", "environment", "solver"}))]
"""


def test_gradient_steps_follow_a_solver_that_takes_no_regularizers(tmp_path: Path) -> None:
    (tmp_path / "old_solver.py").write_text(SOLVER)
    plugins = PluginManager.discover((str(tmp_path / "old_solver.py"),))
    renderer, steps = "reflectance.renderer=old_solver", "reflectance.gradient.iterations=7"

    def found(*assignments: str) -> dict[str, str]:
        return settings_without_effect(load_config(plugins, "fast", assignments=[renderer, *assignments]), plugins)

    assert found(TERM, steps) == {}
    assert "name a term in reflectance.regularizers" in found(steps)["reflectance.gradient.iterations"]
    assert "gradient.iterations" in found(TERM, NO_STEPS)["reflectance.regularizers"]


@pytest.mark.parametrize("preset", sorted(PLUGINS.presets()))
def test_presets_and_values_equal_to_the_presets_are_accepted(preset: str) -> None:
    config = load_config(PLUGINS, preset)
    assert settings_without_effect(config, PLUGINS) == {}
    rate = config.reflectance.gradient.learning_rate
    same = load_config(PLUGINS, preset, assignments=[f"reflectance.gradient.learning_rate={rate}"])
    assert settings_without_effect(same, PLUGINS) == {}


def test_every_setting_of_the_nested_tables_has_a_case() -> None:
    tables = {"gradient": GradientSettings, "path_tracing": PathTracingSettings}
    names = {f"reflectance.{table}.{name}" for table, kind in tables.items() for name in get_type_hints(kind)}
    assert names <= {setting.partition("=")[0] for setting, *_ in WITHOUT_EFFECT}
    assert names <= {setting.partition("=")[0] for setting, *_ in WITH_EFFECT}


def test_options_outside_an_automatic_chain_are_named(tiny_capture: Path, tmp_path: Path) -> None:
    """The chain depends on the capture, so that they are no error: ten small photographs get no stereo."""

    def said(*assignments: str) -> list[str]:
        sentences: list[str] = []
        config = load_config(PLUGINS, "fast", assignments=assignments)
        prepare(tiny_capture, config, PLUGINS, RunDirectory(tmp_path), "cpu", sentences.append)
        return sentences

    [sentence] = said("initializer.stereo.levels=1", "initializer.visual_hull.max_resolution=40")
    assert sentence.startswith("warning: initializer.stereo.levels has no effect: ")
    assert "camera_refinement, visual_hull" in sentence and "name stereo in initializers" in sentence
    assert said() == said("initializer.camera_refinement.when=never") == []


def test_a_run_ends_before_its_folder_is_made(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"reflectance\.gradient\.batch_pixels has no effect"):
        reconstruct(
            "examples/sample_capture",
            tmp_path / "run",
            assignments=["reflectance.gradient.batch_pixels=7"],
            plugins=PLUGINS,
        )
    assert not (tmp_path / "run").exists()


def test_settings_of_a_stage_that_is_switched_off_are_named() -> None:
    config = load_config(PLUGINS, "fast", assignments=["geometry.enabled=false", "geometry.iterations=7"])
    assert settings_without_effect(config, PLUGINS) == {}
    assert settings_of_disabled_stages(config, PLUGINS) == ["geometry.iterations"]
    assert settings_of_disabled_stages(load_config(PLUGINS), PLUGINS) == []
