"""Fixtures for the tests of several packages."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from hir_exporters.textures.ktx2 import MODULES_VARIABLE
from hypothesis import settings
from parity.browser import chromium_command

pytest_plugins = ["tests.fixtures.runs", "tests.fixtures.one_pixel_pictures"]

ROOT = Path(__file__).resolve().parent.parent

settings.register_profile("hir", deadline=None)  # a busy machine must not fail a test
settings.load_profile("hir")


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of test data too large for the repository; tests that need it are skipped where it is missing."""
    folder = Path(os.environ.get("HIR_SHARED", ROOT.parent / "shared"))
    if not folder.is_dir():
        pytest.skip(f"test data not found at {folder}; set HIR_SHARED to its folder")
    return folder


@pytest.fixture(scope="session")
def chromium() -> list[str]:
    """The command of a headless Chromium with software rendering; tests that need it are skipped without it."""
    command = chromium_command()
    if command is None:
        pytest.skip("no Chromium on the path: run tools/setup.sh test as root, or install chromium")
    return command


@pytest.fixture
def ktx2_encoder(monkeypatch: pytest.MonkeyPatch) -> None:
    """The npm package that encodes and decodes KTX2, in the folder that HIR_NODE_MODULES names or in tools."""
    folder = Path(os.environ.get(MODULES_VARIABLE) or ROOT / "tools" / "node_modules")
    if shutil.which("node") is None or not (folder / "ktx2-encoder").is_dir():
        pytest.skip("node or ktx2-encoder is not installed: run tools/setup.sh test")
    monkeypatch.setenv(MODULES_VARIABLE, str(folder))
