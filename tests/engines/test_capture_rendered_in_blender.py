"""The tool that renders captures in Blender keeps the strength of each light."""

from __future__ import annotations

import argparse
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

TOOL = Path(__file__).resolve().parents[2] / "tools" / "render_capture_in_blender.py"


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The tool without Blender, which no function here calls."""
    monkeypatch.setitem(sys.modules, "bpy", ModuleType("bpy"))
    monkeypatch.setitem(sys.modules, "mathutils", SimpleNamespace(Matrix=None, Vector=None))
    spec = spec_from_file_location(TOOL.stem, TOOL)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_lights_of_one_file_name_have_a_strength_each(
    tool: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured = iter([1.0, 2.0, 3.0])
    monkeypatch.setattr(tool, "measured_strength", lambda *_: next(measured))
    options = argparse.Namespace(folder=tmp_path)
    lights = [tmp_path / folder / "studio.hdr" for folder in ("a", "b")]
    for light in lights:
        light.parent.mkdir()
        light.write_text(light.parent.name)
    names = [*map(str, lights), "camera"]
    assert [tool.known_strength(None, None, name, options) for name in names] == [1, 2, 3]
    assert [tool.known_strength(None, None, name, options) for name in names] == [1, 2, 3], "measured once"
