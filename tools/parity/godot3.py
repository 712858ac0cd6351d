"""Godot 3, as Debian packages it, on a virtual screen with Mesa's software renderer: renders files to pictures."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from hir_exporters.textures.image_files import read_ldr
from numpy.typing import NDArray

from hir_core.capture import Camera
from parity.shots import shot_document

PROJECT: Final = Path(__file__).resolve().parent / "godot"
TIMEOUT_S: Final = 900


def godot_missing() -> str:
    """What must be installed; empty if nothing."""
    return "" if shutil.which("godot3") and shutil.which("xvfb-run") else "Godot 3: apt-get install godot3 xvfb"


def godot_version() -> str:
    """The version number, such as 3.2.3."""
    output = subprocess.run(["godot3", "--version"], capture_output=True, text=True, check=False).stdout
    return ".".join(output.split(".")[:3])


def render_in_godot(file: Path, light: Path, cameras: Sequence[Camera]) -> list[NDArray[np.float32]]:
    """Opaque sRGB pictures over black (H, W, 3), imported by the editor and rendered by GLES3.

    Raises `RuntimeError` where Godot renders none.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for source in PROJECT.iterdir():
            shutil.copy(source, folder)
        shutil.copy(file, folder / "asset.glb")
        shutil.copy(light, folder / "asset.hdr")
        (folder / "shots.json").write_text(json.dumps([shot_document(c) for c in cameras]), encoding="utf-8")
        # The editor imports the files on start; it is terminated when the import has finished.
        _run(folder, ["--editor"], lambda: any((folder / ".import").glob("asset.glb-*.md5")))
        pictures = [folder / f"{index}.png" for index in range(len(cameras))]
        output = _run(folder, ["-s", "shots.gd"], lambda: False)
        if not all(picture.is_file() for picture in pictures):
            raise RuntimeError(f"Godot rendered no pictures of {file.name}: {output[-600:]}")
        return [read_ldr(picture)[..., :3] for picture in pictures]


def _run(folder: Path, arguments: list[str], is_done: Callable[[], bool]) -> str:
    """Runs Godot until it exits or `is_done` returns True; returns its output."""
    log = folder / "godot.log"
    command = ["xvfb-run", "-a", "-s", "-screen 0 640x480x24", "godot3", "--path", str(folder), *arguments]
    with open(log, "wb") as stream:
        process = subprocess.Popen(
            command, stdout=stream, stderr=stream, start_new_session=True, env={**os.environ, "HOME": str(folder)}
        )
        end = time.monotonic() + TIMEOUT_S
        while process.poll() is None and time.monotonic() < end and not is_done():
            time.sleep(0.5)
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGTERM)
            process.wait(30)
    return log.read_text(encoding="utf-8", errors="replace")
