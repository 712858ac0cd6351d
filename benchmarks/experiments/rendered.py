"""Captures that Cycles renders for the studies, so that no own renderer makes its own test data."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from benchmarks.experiments.folders import ROOT, WORK, shared

COMMANDS = {
    "flash": ("--views", "60", "--test-views", "8", "--size", "128", "--samples", "64", "--light", "camera"),
}
"""Options of `tools/render_capture_in_blender.py` for each, with captures/spot's mesh and its texture."""


def rendered(name: str) -> Path:
    """The folder of a capture; rendered first where it is not there yet and Blender is (`tools/setup.sh blender`)."""
    folder = WORK / "captures" / name
    blender = Path(os.environ.get("HIR_BLENDER_PYTHON", ROOT / ".venv-blender" / "bin" / "python"))
    model, texture = shared() / "captures" / "spot" / "reference.obj", shared() / "models" / "spot" / "spot_texture.png"
    if not (folder / "transforms_test.json").is_file() and blender.is_file() and model.is_file() and texture.is_file():
        tool = ROOT / "tools" / "render_capture_in_blender.py"
        words = [blender, tool, model, folder, "--texture", texture, *COMMANDS[name]]
        subprocess.run([str(word) for word in words], check=True, stdout=subprocess.DEVNULL)
    return folder
