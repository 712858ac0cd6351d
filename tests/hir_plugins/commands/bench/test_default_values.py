"""Studies of constants and of variation: their values are the code's; a difference needs two standard errors."""

from __future__ import annotations

import json
from importlib import import_module
from pathlib import Path

import pytest

from benchmarks import default_values, seeds_and_threads
from benchmarks.default_values import DEFAULT_VALUES, changed, gain_of, study
from hir_core.config import RunConfig, load_config
from hir_core.plugins.manager import PluginManager
from hir_plugins.commands.bench.inputs.materials_captures import MaterialsCapture
from hir_plugins.commands.bench.results.bench_result import Timing
from hir_plugins.commands.bench.suites.materials_run import RunFigures, RunKey

PLUGINS = PluginManager.discover()


@pytest.mark.parametrize("name", DEFAULT_VALUES)
def test_the_studied_values_are_those_of_the_code(name: str) -> None:
    """A constant that was moved, renamed or changed fails here."""
    default = DEFAULT_VALUES[name]
    assert bool(default.setting) != bool(default.constants) and default.value not in default.candidates
    for constant in default.constants:
        module, _, attribute = constant.partition(":")
        assert getattr(import_module(module), attribute) == default.value
    if default.setting:
        assert "stereo" not in load_config(PLUGINS).initializers, "the stereo study adds it"
        for value in default.candidates:
            assert isinstance(load_config(PLUGINS, assignments=(f"{default.setting}={value}",)), RunConfig)


def test_a_constant_is_changed_in_every_module_and_restored() -> None:
    default = DEFAULT_VALUES["texel_prior_weight"]
    modules = [import_module(constant.partition(":")[0]) for constant in default.constants]
    with pytest.raises(RuntimeError), changed(default, 0.5):
        assert [module.TEXEL_PRIOR_WEIGHT for module in modules] == [0.5] * len(modules)  # type: ignore[attr-defined]
        raise RuntimeError
    assert [module.TEXEL_PRIOR_WEIGHT for module in modules] == [0.01] * len(modules)  # type: ignore[attr-defined]


def test_a_difference_needs_two_standard_errors_over_captures() -> None:
    today = {"a": [30.0, 30.0], "b": [20.0, 20.0], "c": [25.0, 25.0]}
    clear = gain_of(today, {"a": [31.0, 31.2], "b": [21.0, 21.2], "c": [26.0, 26.2]})
    assert clear.mean == pytest.approx(1.1) and clear.standard_error == pytest.approx(0.0, abs=1e-9)
    assert clear.seeds_deviation == pytest.approx(0.2 / 2**0.5) and clear.verdict == "better"
    noisy = gain_of(today, {"a": [34.0, 34.0], "b": [20.0, 20.0], "c": [24.5, 24.5]})
    assert noisy.mean > 1 and noisy.verdict == "no difference"
    assert gain_of(today, {name: [v - 1 for v in found] for name, found in today.items()}).verdict == "worse"
    single = gain_of({"a": [30.0]}, {"a": [40.0]})
    assert single.verdict == "no difference" and single.seeds_deviation is None, "one capture decides nothing"


def test_a_study_compares_each_candidate_with_today_on_the_same_captures_and_seeds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keys: list[RunKey] = []

    def figures(key: RunKey, *rest: object) -> RunFigures:
        keys.append(key)
        from hir_plugins.reflectance_renderers.transport_ggx.textures import texture_solve

        level = 30.0 - 100 * abs(texture_solve.TEXEL_PRIOR_WEIGHT - 0.003) + {"a": 0, "b": 2}[key.capture]
        errors = {"unseen dB, object": level, "relit scaled dB, frame": 20.0}
        return RunFigures("metal", "world", "m", errors, Timing(1, 1, 1, 1, 1), {}, {})

    monkeypatch.setattr(default_values, "run_figures", figures)
    captures = [MaterialsCapture(tmp_path / name, "tuning", "metal", "world", True) for name in "ab"]
    found = study("texel_prior_weight", captures, (0, 1), tmp_path, PLUGINS)
    assert len(keys) == 3 * 2 * 2 and len({(key.variant, key.capture, key.seed) for key in keys}) == 12
    unseen = {value: gains["unseen dB, object"] for value, gains in found["gains"].items()}
    assert unseen["0.003"]["mean"] == pytest.approx(0.7) and unseen["0.003"]["verdict"] == "better"
    assert unseen["0.05"]["mean"] == pytest.approx(-4.0) and unseen["0.05"]["verdict"] == "worse"
    assert found["gains"]["0.05"]["relit scaled dB, frame"]["verdict"] == "no difference"
    assert found["commit"] is not None and found["machine"]["processor"] and found["seeds"] == [0, 1]


def test_the_page_of_studies_names_every_constant() -> None:
    page = (Path(default_values.__file__).parents[1] / "docs" / "studies" / "default_values.md").read_text("utf-8")
    for name in DEFAULT_VALUES:
        assert f"`{name}`" in page, name


def test_the_spread_of_runs_is_a_standard_deviation_and_the_models_are_listed() -> None:
    runs = [{"unseen": {"frame": 38.0 + i, "object": 30.0 + 0.1 * i}, "model": f"m{i // 2}"} for i in range(3)]
    found = seeds_and_threads.summary(runs)
    assert found["frame"]["standard_deviation_db"] == pytest.approx(1.0) and not found["frame"]["within_goal"]
    assert found["object"]["standard_deviation_db"] == pytest.approx(0.1) and found["object"]["within_goal"]
    assert found["models"] == ["m0", "m1"] and found["frame"]["range_db"] == pytest.approx(2.0)
    assert seeds_and_threads.summary(runs[:1])["frame"]["standard_deviation_db"] is None


def test_a_finished_run_is_not_repeated(tmp_path: Path) -> None:
    (tmp_path / "figures.json").write_text(json.dumps({"seed": 3}))
    assert seeds_and_threads.run(tmp_path / "missing", tmp_path, 3, 1) == {"seed": 3}
