"""`hir doctor` on machines where all is well, where something lacks, and where a library cannot be opened."""

from __future__ import annotations

import json

import pytest

from hir_core.cli import main
from hir_core.run import installation_check


def hir(*words: str) -> int:
    """Runs `hir` in this process and returns its exit code."""
    with pytest.raises(SystemExit) as stop:
        main(list(words))
    assert isinstance(stop.value.code, int)
    return stop.value.code


def test_a_sound_machine(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(installation_check, "_try", lambda _: (0, ""))
    monkeypatch.setattr(installation_check, "find_spec", lambda _: True)
    assert hir("doctor") == 0
    told = capsys.readouterr().out
    assert all(name in told for name in ("python", "torch", "mitsuba", "renderer (cpu)", "renderer (cuda)", "lpips"))
    assert hir("doctor", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert {finding["state"] for finding in found} == {"ok"}


def test_what_lacks_is_told_with_the_command_that_brings_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(installation_check, "find_spec", lambda _: None)
    assert hir("doctor") == 1
    told = capsys.readouterr().out
    assert "missing" in told and "pip install 'hir[reconstruct]'" in told and "renderer (cpu)" not in told


def test_a_library_that_cannot_be_opened_is_told_with_its_package(monkeypatch: pytest.MonkeyPatch) -> None:
    said = "Traceback\nImportError: libGL.so.1: cannot open shared object file\n"
    monkeypatch.setattr(installation_check, "_try", lambda _: (1, said))
    found = {finding.name: finding for finding in installation_check.examine(["a plugin is broken"])}
    assert found["open3d"].state == "broken" and found["open3d"].advice == "apt-get install libgl1"
    assert found["renderer (cpu)"].state == "broken" and "libllvm19" in found["renderer (cpu)"].advice
    assert found["renderer (cuda)"].state == "absent", "no GPU is no fault"
    assert found["plugin"].state == "broken"
    assert installation_check.last_line(" \n") == ""
