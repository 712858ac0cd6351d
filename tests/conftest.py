"""Fixtures for the tests of several packages."""

from __future__ import annotations

import gc
import os
import shutil
import sys
from pathlib import Path

import pytest
from hir_exporters.textures.ktx2 import MODULES_VARIABLE
from hypothesis import settings
from parity.browser import chromium_command

pytest_plugins = ["tests.fixtures.virtual_environments", "tests.fixtures.runs", "tests.fixtures.one_pixel_pictures"]

ROOT = Path(__file__).resolve().parent.parent

settings.register_profile("hir", deadline=None)  # a busy machine must not fail a test
settings.load_profile("hir")


def pytest_collection_finish(session: pytest.Session) -> None:
    """Refuses tests whose imports raise the number of threads, and keeps what was imported from garbage collection.

    With two threads in each of two processes on two cores, tests of geometry took ten times as long. What was imported
    is never freed, and each full collection took 0.3 s to look at its 500,000 objects.
    """
    del session
    torch, threads = sys.modules.get("torch"), os.environ.get("OMP_NUM_THREADS", "")
    if torch is not None and threads.isdecimal() and torch.get_num_threads() > int(threads):
        raise pytest.UsageError(
            f"a module of tests raises the number of threads from {threads} to {torch.get_num_threads()} when it is "
            "imported, for all other tests; import the library that does so inside of its tests"
        )
    gc.collect()
    gc.freeze()


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
