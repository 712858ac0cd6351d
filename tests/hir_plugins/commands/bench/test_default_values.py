"""Studies of constants and of variation: their values are the code's; a difference needs two standard errors."""

from __future__ import annotations

import json
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks import default_values, seeds_and_threads
from benchmarks.changed_constant import find_constant, install
from benchmarks.default_values import DEFAULT_VALUES, Gain, gain_of, study
from hir_core.config import load_config
from hir_core.errors import ConfigError
from hir_core.plugins.manager import PluginManager
from hir_plugins.commands.bench.results.bench_result import Result, Row, Timing

PLUGINS = PluginManager.discover()


@pytest.mark.parametrize("name", DEFAULT_VALUES)
def test_the_studied_values_are_those_of_the_code(name: str) -> None:
    """A constant that was renamed or changed fails here."""
    default = DEFAULT_VALUES[name]
    assert bool(default.setting) != bool(default.constant) and default.value not in default.candidates
    if default.constant:
        package, _, constant = default.constant.partition(":")
        assert find_constant(package, constant)[2] == default.value
    else:
        config: object = load_config(PLUGINS)
        for value in default.candidates:
            assert load_config(PLUGINS, assignments=(*default.fixed, f"{default.setting}={value}")) != config
            assert default.command(value)[3:] == [
                *(argument for setting in default.fixed for argument in ("--set", setting)),
                *("--set", f"{default.setting}={value}"),
            ]
        if default.setting in ("initializers", "atlas.texture_size"):
            for part in default.setting.split("."):
                config = getattr(config, part)
            assert config == default.value


def test_a_changed_constant_reaches_imports_and_default_arguments(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "changed_package"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "first.py").write_text("LIMIT = 1.0\nTOO_LIMIT = 7\n")
    (package / "second.py").write_text("from .first import LIMIT\ndef f(limit=LIMIT): return limit, LIMIT\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(sys, "meta_path", list(sys.meta_path))
    install("changed_package:LIMIT=0.25")
    assert import_module("changed_package.second").f() == (0.25, 0.25)
    assert import_module("changed_package.first").TOO_LIMIT == 7
    for text, message in (
        ("changed_package:LIMIT=3", "imported already"),
        ("changed_package:NOTHING=3", "0 modules define NOTHING"),
        ("changed_package.LIMIT=3", "PACKAGE:NAME=VALUE"),
    ):
        with pytest.raises(ConfigError, match=message):
            install(text)


def test_a_difference_needs_two_standard_errors_over_captures() -> None:
    today = {"a": [30.0, 30.0], "b": [20.0, 20.0], "c": [25.0, 25.0]}
    clear = gain_of(today, {"a": [31.0, 31.2], "b": [21.0, 21.2], "c": [26.0, 26.2]})
    assert clear.mean == pytest.approx(1.1) and clear.standard_error == pytest.approx(0.0, abs=1e-9)
    assert clear.seeds_deviation == pytest.approx(0.2 / 2**0.5) and clear.verdict == "better"
    noisy = gain_of(today, {"a": [34.0, 34.0], "b": [20.0, 20.0], "c": [24.5, 24.5]})
    assert noisy.mean > 1 and noisy.verdict == "no difference"
    assert gain_of(today, {name: [v - 1 for v in found] for name, found in today.items()}).verdict == "worse"
    few, many = Gain(2.1, 1.0, None, 4), Gain(2.1, 1.0, None, 60)
    assert few.verdict == "no difference" and few.required_standard_errors == pytest.approx(3.182, abs=1e-3)
    assert many.verdict == "better" and many.required_standard_errors == pytest.approx(2.0, abs=0.01)
    single = gain_of({"a": [30.0]}, {"a": [40.0]})
    assert single.verdict == "no difference" and single.seeds_deviation is None, "one capture decides nothing"


def test_a_study_compares_each_candidate_with_today_on_the_same_captures_and_seeds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    commands: list[list[str]] = []

    def run(command: list[str], check: bool) -> None:
        """What `hir bench materials` would write: 30 dB, 1 more and 4 less with the candidates."""
        commands.append(command)
        change = [0.0, 1.0, -4.0][len(commands) - 1]
        rows = []
        for number, capture in enumerate("ab"):
            for seed in (0, 1):
                errors = {"unseen dB, object": 30.0 + number + change, "relit scaled dB, frame": 20.0}
                case = {"half": "tuning", "capture": capture, "mesh": "truth", "seed": seed}
                rows.append(Row(case, "selected", "ours", Timing(1, 1, 1, 1, 1), errors))
                rows.append(Row(case, "forced: metal", "ours", Timing(1, 1, 1, 1, 1), {}))
        folder = Path(command[command.index("-o") + 1])
        folder.mkdir(parents=True)
        Result("materials", tuple(rows)).write(folder / "materials.json")

    monkeypatch.setattr(default_values, "subprocess", SimpleNamespace(run=run))
    found = study("texel_prior_weight", tmp_path, ["--seeds", "0,1"])
    constant = f"{default_values.TEXTURES}:TEXEL_PRIOR_WEIGHT"
    assert [command[2:4] for command in commands] == [
        ["hir_core.cli", "bench"],
        ["benchmarks.changed_constant", f"{constant}=0.003"],
        ["benchmarks.changed_constant", f"{constant}=0.05"],
    ]
    assert len({command[command.index("--workspace") + 1] for command in commands}) == 3, "results are not mixed"
    unseen = {value: gains["unseen dB, object"] for value, gains in found["gains"].items()}
    assert unseen["0.003"]["mean"] == pytest.approx(1.0) and unseen["0.003"]["verdict"] == "better"
    assert unseen["0.05"]["mean"] == pytest.approx(-4.0) and unseen["0.05"]["verdict"] == "worse"
    assert found["gains"]["0.05"]["relit scaled dB, frame"]["verdict"] == "no difference"
    assert found["machine"]["processor"] and found["arguments"] == ["--seeds", "0,1"]


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
