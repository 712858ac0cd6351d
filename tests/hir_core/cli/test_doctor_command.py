"""`hir doctor` on machines where all is well, where something lacks, and where a library cannot be opened."""

from __future__ import annotations

import json

import pytest

from hir_core.run import installation_check
from tests.fixtures.command_line import hir


def test_a_sound_machine(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(installation_check, "_try", lambda _: (0, ""))
    monkeypatch.setattr(installation_check, "find_spec", lambda _: True)
    assert hir("doctor") == 0
    output = capsys.readouterr().out
    assert all(name in output for name in ("python", "torch", "mitsuba", "renderer (cpu)", "renderer (cuda)", "lpips"))
    assert hir("doctor", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert {finding["state"] for finding in found} == {"ok"}


def test_a_missing_package_is_reported_with_the_command_that_installs_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(installation_check, "_try", lambda _: (0, ""))
    monkeypatch.setattr(installation_check, "find_spec", lambda name: True if name == "scipy" else None)
    assert hir("doctor") == 1
    output = capsys.readouterr().out
    lines = {line.split()[1]: line.split()[0] for line in output.splitlines() if len(line.split()) > 1}
    assert lines["lpips"] == lines["ray"] == "absent", "optional extras are no fault"
    assert lines["torch"] == "missing" and "pip install 'hir[reconstruct]'" in output and "renderer (cpu)" not in output


def test_an_installation_for_exports_alone_is_sound(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(installation_check, "find_spec", lambda _: None)
    assert hir("doctor") == 0
    output = capsys.readouterr().out
    assert "missing" not in output and "pip install 'hir[reconstruct]'" in output


def test_a_library_that_cannot_be_opened_is_reported_with_its_package(monkeypatch: pytest.MonkeyPatch) -> None:
    message = "Traceback\nImportError: libGL.so.1: cannot open shared object file\n"
    monkeypatch.setattr(installation_check, "_try", lambda _: (1, message))
    found = {finding.name: finding for finding in installation_check.examine(["a plugin is broken"])}
    assert found["open3d"].state == "broken" and found["open3d"].advice == "apt-get install libgl1"
    assert found["renderer (cpu)"].state == "broken" and "libllvm19" in found["renderer (cpu)"].advice
    assert found["renderer (cuda)"].state == "absent", "no GPU is no fault"
    assert found["plugin"].state == "broken"
    assert installation_check.last_line(" \n") == ""


def test_a_gpu_that_only_pytorch_can_use_is_a_fault_with_its_mend(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run would choose it and fail in the reflectance stage."""
    monkeypatch.setattr(
        installation_check, "_try", lambda command: (0 if "torch.cuda" in command[-1] else 1, "no OptiX")
    )
    found = installation_check.examine_renderer("cuda_ad_rgb", "renderer (cuda)")
    assert found.state == "broken" and "OptiX" in found.advice and "--device cpu" in found.advice
