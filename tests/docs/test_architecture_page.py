"""docs/architecture.md and its drawing name paths that exist."""

from __future__ import annotations

import re

import pytest

from tests.docs.checkout import DOCS, ROOT, tool

TOOL = tool("draw_data_flow")
PAGE = (DOCS / "architecture.md").read_text(encoding="utf-8")
NAMED = re.findall(r"`([\w.]+(?:/[\w.]+)+)`", PAGE)


def test_page_names_the_folders() -> None:
    assert len(NAMED) > 40


@pytest.mark.parametrize("path", dict.fromkeys(NAMED))
def test_path_of_the_page_exists(path: str) -> None:
    assert (ROOT / path).exists()


@pytest.mark.parametrize("step", TOOL.STEPS, ids=lambda step: step.file)
def test_file_of_a_step_exists(step: object) -> None:
    assert (ROOT / str(getattr(step, "file", ""))).is_file()


def test_drawing_is_current() -> None:
    assert TOOL.FILE.read_text(encoding="utf-8") == TOOL.picture(), "run: python tools/draw_data_flow.py"


@pytest.mark.parametrize("layer", ["hir_core", "hir_plugins", "exporters/hir_exporters"])
def test_every_folder_of_a_layer_is_on_the_page(layer: str) -> None:
    folders = [path for path in sorted((ROOT / layer).iterdir()) if (path / "__init__.py").is_file()]
    missing = [name for name in (str(path.relative_to(ROOT)) for path in folders) if f"`{name}" not in PAGE]
    assert missing == []
