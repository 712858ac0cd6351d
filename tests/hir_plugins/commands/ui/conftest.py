"""A running server of `hir ui` with an empty library."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from hir_plugins.commands.ui.capture_library import CaptureLibrary
from hir_plugins.commands.ui.command import preset_choices
from hir_plugins.commands.ui.ui_server import UiServer


@pytest.fixture
def server(tmp_path: Path) -> Iterator[UiServer]:
    library = CaptureLibrary(tmp_path / "library")
    with UiServer(library, preset_choices()) as running:
        thread = threading.Thread(target=running.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        yield running
        running.shutdown()
        thread.join()
    library.close()
