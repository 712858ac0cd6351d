"""The example plugin of each version of the plugin interface, frozen, under the contracts of today."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path

import pytest

from hir_core.plugins import API_VERSION
from tests.docs.blocks import Reader

FROZEN = Path(__file__).resolve().parents[2] / "fixtures" / "plugins_of_interface"
QUICK, SLOW = ("light_chroma", "ply"), ("midpoint_outline", "supersampled")

CHECKSUMS = {
    1: "87ec15cfd8bc39a248697ca28c9568e23439276a37f96e144ba32404cf7f9cdb",
}
"""SHA-256 over all files of a frozen copy. A copy is never changed; a new version of the interface brings a new one."""

BREAKS: Mapping[int, Mapping[str, Mapping[str, str]]] = {}
"""Of each version before ours: component, contract that its frozen copy breaks today, and what was announced."""


def checksum(folder: Path) -> str:
    state = hashlib.sha256()
    for file in sorted(f for f in folder.rglob("*") if f.is_file() and "__pycache__" not in f.parts):
        state.update(f"{file.relative_to(folder).as_posix()}\n".encode())
        state.update(file.read_bytes().replace(b"\r\n", b"\n"))
    return state.hexdigest()


def test_every_version_has_a_frozen_copy_that_nobody_changed() -> None:
    assert sorted(CHECKSUMS) == list(range(1, API_VERSION + 1))
    assert {folder.name for folder in FROZEN.iterdir()} == {str(version) for version in CHECKSUMS}
    assert {version: checksum(FROZEN / str(version)) for version in CHECKSUMS} == CHECKSUMS


def broken(version: int, component: str, folder: Path) -> dict[str, str]:
    """Contracts of today that a component of a frozen copy breaks, installed as a third party would."""
    reader = Reader(folder)
    shutil.copytree(FROZEN / str(version), folder / "project", ignore=shutil.ignore_patterns("__pycache__"))
    if version != API_VERSION:  # it would be refused; what else breaks it is the question
        descriptors = folder / "project" / "hir_example" / "plugin.py"
        text = re.sub(r"\bapi=\d+,\s*", "", descriptors.read_text(encoding="utf-8"))
        descriptors.write_text(text.replace("Component(\n", f"Component(\n    api={API_VERSION},\n"), encoding="utf-8")
    reader._command("pip install -e project")
    done = reader._run_any(["check-plugin", component, "--json"])
    assert isinstance(done, subprocess.CompletedProcess)
    results = json.loads(done.stdout)["results"]
    assert any(r["outcome"] == "passed" for r in results), done.stderr
    return {r["check"]: r["detail"] for r in results if r["outcome"] == "failed"}


@pytest.mark.parametrize("version", CHECKSUMS)
@pytest.mark.parametrize("component", [*QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)])
def test_the_contracts_of_today_hold_for_it(version: int, component: str, tmp_path: Path) -> None:
    found = broken(version, component, tmp_path)
    assert set(found) == set(BREAKS.get(version, {}).get(component, {})), found
