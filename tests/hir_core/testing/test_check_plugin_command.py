"""`hir check-plugin`: what it prints, and its exit code."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hir_core.cli import main
from hir_core.errors import PluginError
from hir_core.testing.running import subject_of

BROKEN = """
from hir_core.plugins.interfaces import Regularizer
from hir_core.plugins import Component, hookimpl


class Silent(Regularizer):
    def prepare(self, scene):
        return lambda scene: None


@hookimpl
def hir_register_regularizers():
    return [Component(name="silent", target=f"{__name__}:Silent", config=None, summary="Says nothing of what it is.")]
"""


def hir(*words: object) -> int:
    """Runs `hir` in this process and returns its exit code."""
    with pytest.raises(SystemExit) as stop:
        main([str(word) for word in words])
    assert isinstance(stop.value.code, int)
    return stop.value.code


def test_a_sound_component_is_told_check_by_check(capsys: pytest.CaptureFixture[str]) -> None:
    words = (
        "check-plugin",
        "regularizer:edge_length",
        "--only",
        "gradient_is_that_of_the_value",
        "--only",
        "imports_light",
    )
    assert hir(*words) == 0
    told = capsys.readouterr().out
    assert "regularizer edge_length (hir)" in told and " ok  imports_light" in told and "0 are broken" in told
    assert hir(*words, "--json") == 0
    results = json.loads(capsys.readouterr().out)["results"]
    assert {r["outcome"] for r in results} == {"passed"} and {r["component"] for r in results} == {"edge_length"}
    assert hir(*words, "-q") == 0
    assert len(capsys.readouterr().out.splitlines()) == 1, "the sum alone"


def test_a_broken_plugin_file_is_told_with_its_contract(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "silent.py").write_text(BROKEN)
    assert hir("check-plugin", tmp_path / "silent.py", "-q") == 2
    told = capsys.readouterr().out
    assert "FAILED" in told and "contract:" in told and "seen:" in told and "0 contracts hold" not in told


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("nobody",), "no component and no distribution is called 'nobody'"),
        (("edge_length", "--only", "is_pretty"), "has no check 'is_pretty'; its checks are: "),
        (("edge_length", "--set", "weigth=2"), "weigth"),
    ],
)
def test_wrong_words_are_one_sentence(words: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert hir("check-plugin", *words) == 2
    assert said in "".join(capsys.readouterr())


def test_a_name_of_several_components_is_not_guessed() -> None:
    with pytest.raises(PluginError, match=r"is the name of several components; say which: .*:hir"):
        subject_of("hir")
