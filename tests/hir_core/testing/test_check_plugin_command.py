"""`hir check-plugin`: what it prints, and its exit code."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hir_core.errors import PluginError
from hir_core.testing.running import subject_of
from tests.fixtures.command_line import hir

BROKEN = """
from hir_core.plugins.interfaces import Regularizer
from hir_core.plugins import Component, hookimpl


class Silent(Regularizer):
    def prepare(self, scene):
        return lambda scene: None


@hookimpl
def hir_register_regularizers():
    return [Component(name="silent", target=f"{__name__}:Silent", summary="Says nothing of what it is.")]
"""


def test_results_are_printed_check_by_check(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = (
        "check-plugin",
        "regularizer:edge_length",
        "--only",
        "gradient_is_that_of_the_value",
        "--only",
        "imports_light",
    )
    assert hir(*arguments) == 0
    output = capsys.readouterr().out
    assert "regularizer edge_length (hir)" in output and " ok  imports_light" in output and "0 failed" in output
    assert hir(*arguments, "--json") == 0
    results = json.loads(capsys.readouterr().out)["results"]
    assert {r["outcome"] for r in results} == {"passed"} and {r["component"] for r in results} == {"edge_length"}
    lines = output.splitlines()
    assert lines[-1] == "2 checks passed, 0 failed, 0 skipped" and len(lines) == 4, "prerequisites are not counted"
    assert hir(*arguments, "-q") == 0
    assert len(capsys.readouterr().out.splitlines()) == 1, "the sum alone"


@pytest.mark.parametrize(
    ("name", "check"), [("tensorboard", "observer_raises_nothing"), ("card", "commands_have_help")]
)
def test_the_name_of_an_observer_or_command_means_its_plugin(
    name: str, check: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert hir("check-plugin", name, "--only", check) == 0
    assert f"plugin {name}" in (output := capsys.readouterr().out) and f" ok  {check}" in output


def test_the_sum_agrees_with_the_lines(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "watcher.py"
    file.write_text("from hir_core.plugins import hookimpl\n\n\n@hookimpl\ndef hir_progress(progress):\n    pass\n")
    assert hir("check-plugin", file) == 0
    *lines, last = capsys.readouterr().out.splitlines()
    assert last == f"{sum(' ok ' in line for line in lines)} checks passed, 0 failed, 0 skipped, 5 do not concern it"


def test_a_broken_plugin_file_is_reported_with_its_contract(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "silent.py").write_text(BROKEN)
    assert hir("check-plugin", tmp_path / "silent.py", "-q") == 2
    output = capsys.readouterr().out
    assert "FAILED" in output and "contract:" in output and "seen:" in output and "0 checks passed" not in output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("nobody",), "no component, observer, command or distribution has the name 'nobody'"),
        (("edge_length", "--only", "is_pretty"), "has no check 'is_pretty'; its checks are: "),
        (("edge_length", "--set", "weigth=2"), "weigth"),
    ],
)
def test_wrong_words_are_one_sentence(
    arguments: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert hir("check-plugin", *arguments) == 2
    assert message in "".join(capsys.readouterr())


def test_a_name_of_several_components_is_not_guessed() -> None:
    with pytest.raises(PluginError, match=r"is the name of several components; choose one of: .*:hir"):
        subject_of("hir")
