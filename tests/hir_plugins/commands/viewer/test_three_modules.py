"""The minified three.js in the package is what tools/copy_three.py makes of the pinned npm release."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import shutil
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from hir_plugins.commands.viewer.three_modules import MODULES, module_source, page_folder, three_version

TOOLS = Path(__file__).resolve().parents[4] / "tools"
THREE = Path(str(page_folder())) / "three"
MANIFEST: dict[str, Any] = json.loads((THREE / "manifest.json").read_text(encoding="utf-8"))


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def installed(package: str) -> Path:
    folder = TOOLS / "node_modules" / package
    if not folder.is_dir():
        pytest.skip(f"{package} is not installed: run tools/setup.sh test")
    return folder


def copy_three() -> ModuleType:
    """tools/copy_three.py as a module."""
    spec = importlib.util.spec_from_file_location("copy_three", TOOLS / "copy_three.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_folder_contains_the_files_of_the_manifest_unchanged() -> None:
    assert {path.name for path in THREE.iterdir()} == {*MANIFEST["files"], "manifest.json"}
    for name, entry in MANIFEST["files"].items():
        assert sha256(THREE / name) == entry["sha256"], name
    assert {module.path for module in MODULES} == {
        "viewer.js",
        *(f"three/{name}" for name in MANIFEST["files"] if name != "LICENSE"),
    }


def test_the_versions_are_those_of_the_lock_file() -> None:
    packages = json.loads((TOOLS / "package-lock.json").read_text(encoding="utf-8"))["packages"]
    assert MANIFEST["three"] == packages["node_modules/three"]["version"] == three_version()
    assert MANIFEST["terser"] == packages["node_modules/terser"]["version"]


def test_the_sources_are_those_of_the_npm_package() -> None:
    three = installed("three")
    assert json.loads((three / "package.json").read_text(encoding="utf-8"))["version"] == MANIFEST["three"]
    for name, entry in MANIFEST["files"].items():
        assert sha256(three / entry["source"]) == entry["source_sha256"], name


@pytest.mark.parametrize(
    "name",
    [
        "HDRLoader.min.js",
        "SkeletonUtils.min.js",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in MANIFEST["files"]
            if name not in ("LICENSE", "HDRLoader.min.js", "SkeletonUtils.min.js")
        ),
    ],
)
def test_minifying_the_npm_package_again_gives_the_same_bytes(name: str) -> None:
    if shutil.which("node") is None:
        pytest.skip("node is not installed: run tools/setup.sh test")
    three = installed("three")
    installed("terser")
    assert copy_three().minified(three / MANIFEST["files"][name]["source"]) == (THREE / name).read_bytes()


def test_every_module_keeps_its_licence_comment_or_has_none() -> None:
    for module in MODULES:
        if module.name.startswith("three."):
            assert b"SPDX-License-Identifier: MIT" in module_source(module)
