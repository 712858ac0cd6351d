"""Hypotheses with a lamp near the camera: when they take part, and when one is selected."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from hir_core.config import ReflectanceSettings
from hir_core.errors import ConfigError
from hir_core.plugins.model_spec import ModelSpec
from hir_core.stages.reflectance.reflectance_report import (
    explanation_report,
    hypothesis_reports,
    lamp_report,
    near_tie_warning,
)
from hir_core.stages.reflectance.selection.fit_sequence import FitSequence
from hir_core.stages.reflectance.selection.hypotheses import (
    INTERREFLECTIONS,
    complexity,
    contains,
    forcing_settings,
    hypotheses,
    hypothesis,
    simplest_of,
)
from hir_core.stages.reflectance.selection.model_selection import Selection, select_model
from hir_core.stages.reflectance.selection.requested_model import forced_spec
from tests.hir_core.stages.reflectance.selection.scripted_solver import Fit, Recorder, Scripted, level


def select_with_lamp(
    error: Callable[..., float], noise: float = 0.05, views: int = 48, fits_lamp: bool = True, **settings: Any
) -> tuple[Selection[Fit], Scripted]:
    solver, recorder = Scripted(error, noise), Recorder()
    sequence = FitSequence(solver, recorder.progress)
    chosen = select_model(sequence, ReflectanceSettings(**settings), views, recorder, fits_lamp=fits_lamp)
    assert recorder.shares == sorted(recorder.shares) and recorder.shares[-1] <= 1
    return chosen, solver


def flash(spec: ModelSpec) -> float:
    """The lamp explains most, and the dielectric more than other kinds."""
    return level({"world": 20, "camera": 24, "lamp": 30}[spec.light] + 3 * (spec.kind == "dielectric"))


@pytest.mark.parametrize("kind", ["diffuse", "dielectric", "metal", "mixed"])
def test_a_lamp_is_selected_where_it_explains_most(kind: str) -> None:
    def error(spec: ModelSpec) -> float:
        return level({"world": 20, "camera": 24, "lamp": 30}[spec.light] + 3 * (spec.kind == kind))

    selection, _ = select_with_lamp(error)
    assert selection.hypothesis.light == "lamp" and selection.hypothesis.kind == kind
    assert selection.spec.lamp and selection.spec.light_frame == "world"
    report = explanation_report(selection)
    assert report is not None and report.chosen == f"{kind}, lamp near the camera"
    assert {each.light_frame for each in hypothesis_reports(selection)} == {"world", "camera", "lamp"}
    assert "lamp near the camera" in selection.spec.name
    lamp = lamp_report(selection)
    assert lamp is not None and lamp.took_part and lamp.compared_with == "diffuse, light on the camera"
    assert lamp.gain_db == pytest.approx(6, abs=0.3) and lamp.held_out_views == 6 and not lamp.near_tie


def test_the_short_fit_of_a_lamp_is_a_small_part_of_the_progress() -> None:
    """A bar that stood at the end of its phase during all of the hypotheses showed a wrong time left."""
    recorder = Recorder()
    select_model(FitSequence(Scripted(flash), recorder.progress), ReflectanceSettings(), 48, recorder, fits_lamp=True)
    reports_of_a_fit, short_fits = 3, 3
    assert recorder.shares[reports_of_a_fit * short_fits - 1] < 0.2
    assert 0.1 < recorder.shares[len(recorder.shares) // 2] < 0.8


@pytest.mark.parametrize("best", ["world", "camera"])
def test_photographs_without_a_flash_pay_for_one_short_fit(best: str) -> None:
    """What is selected and compared is the same as without lamps."""

    def error(spec: ModelSpec) -> float:
        # it contains the light in the world, and is fitted a little more slowly
        explained = "world" if spec.light == "lamp" else spec.light
        return level(20 + 6 * (explained == best) + 2 * (spec.kind == "metal") - 0.3 * spec.lamp)

    (with_lamp, solver), (without, plain) = select_with_lamp(error), select_with_lamp(error, fits_lamp=False)
    assert with_lamp.spec == without.spec and with_lamp.hypothesis == without.hypothesis
    assert hypothesis_reports(with_lamp) == hypothesis_reports(without)
    lamp = lamp_report(with_lamp)
    assert lamp is not None and not lamp.took_part and lamp_report(without) is None
    lamps = [spec for spec, _ in solver.fitted if spec.lamp]
    assert set(lamps) == {hypothesis("diffuse", "lamp")}
    folds = len({views for spec, views in plain.fitted})
    assert len(lamps) <= folds and not any(spec.lamp for spec, _ in plain.fitted)


@pytest.mark.parametrize(
    ("rival", "noise", "takes_part"),
    [("world", 0.02, True), ("world", 0.6, False), ("camera", 0.6, True)],
)
def test_a_lead_within_noise_over_what_a_lamp_contains_is_none(rival: str, noise: float, takes_part: bool) -> None:
    """Of 0.3 dB on average. A light on the camera is no special case of a lamp and a light in the world."""

    def error(spec: ModelSpec) -> float:
        return level(20.3 if spec.lamp else 20.0 if spec.light == rival else 12.0)

    selection, _ = select_with_lamp(error, noise)
    assert any(each.spec.lamp for each in selection.contestants) is takes_part
    lamp = lamp_report(selection)
    assert lamp is not None and lamp.took_part is takes_part and lamp.near_tie is (noise > 0.1)


def test_a_lamp_that_gains_nothing_is_no_warning() -> None:
    """The light in the world is a lamp that is dark: a tie says nothing against it."""
    lamp, world = hypothesis("metal", "lamp"), hypothesis("metal")
    assert contains(lamp, world) and contains(hypothesis("mixed", "lamp"), world)
    assert not contains(lamp, hypothesis("metal", "camera")) and not contains(world, lamp)
    assert not contains(lamp, hypothesis("mixed")) and contains(hypothesis("mixed", "lamp"), lamp)
    assert complexity(lamp) > complexity(hypothesis("mixed", "camera"))

    def error(spec: ModelSpec) -> float:
        # the lamp is ahead while the material is diffuse, and explains no more than the metal does alone
        return level(30.0 if spec.kind == "metal" and spec.light != "camera" else 24.0 if spec.lamp else 20.0)

    selection, _ = select_with_lamp(error)
    assert selection.hypothesis == world and any(each.spec == lamp for each in selection.contestants)
    assert selection.margins[0].spec == lamp and near_tie_warning(selection) is None


def test_refinements_of_a_lamp_are_those_of_a_light_in_the_world() -> None:
    def error(spec: ModelSpec) -> float:
        return flash(spec) * level(2.0 * (spec.normals == "map") + 1.5 * (spec.roughness == "map"))

    selection, solver = select_with_lamp(error)
    assert selection.spec == replace(
        hypothesis("dielectric", "lamp"), normals="map", roughness="map", bounces=selection.spec.bounces
    )
    assert hypothesis("dielectric", "lamp").bounces == INTERREFLECTIONS
    assert any(spec.lamp and spec.specular == "map" for spec, _ in solver.fitted)


def test_settings_name_a_lamp() -> None:
    settings = ReflectanceSettings(light_frame="lamp")
    assert [spec.light for spec in hypotheses(settings)] == ["lamp"] * 4
    assert forced_spec(replace(settings, model="normal_map")) == replace(
        hypothesis("dielectric", "lamp"), bounces=0, normals="map"
    )
    assert simplest_of(hypothesis("metal", "lamp")).light == "lamp"
    assert forcing_settings(hypothesis("metal", "lamp")).endswith("--set reflectance.light_frame=lamp")
    with pytest.raises(ConfigError, match="the same for all photographs"):
        forced_spec(replace(settings, model="per_texel_brdf"))
    known = ReflectanceSettings(light_frame="lamp", known_environment="room.hdr")
    assert all(spec.light_is_known and spec.lamp for spec in hypotheses(known))
    with pytest.raises(ValueError, match="light_frame='world'"):
        ModelSpec(light_frame="camera", lamp=True)
