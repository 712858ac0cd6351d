"""The ready scripts of examples/engines, run as the files that they are."""

from __future__ import annotations

import shutil
import subprocess
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.formats import create_exporter
from hir_exporters.images import read_ldr
from parity.browser import module_folder
from parity.engines import blender_python

from hir_core.capture import Camera
from hir_core.render import look_at

from .octants import asset

SCRIPTS = Path(__file__).resolve().parents[2] / "examples" / "engines"

pytestmark = pytest.mark.slow


def camera(away: float, side: int) -> Camera:
    """Where both scripts put it: 35 degrees high, `away` radii of the box's sphere in the direction (0.5, 0.4, 1)."""
    radius = float(np.linalg.norm([0.9, 0.6, 0.7]))
    toward = np.array([0.5, 0.4, 1.0])
    focal = side / 2 / np.tan(np.radians(17.5))
    intrinsics = np.array([[focal, 0, side / 2], [0, focal, side / 2], [0, 0, 1.0]])
    return Camera(intrinsics, look_at(toward / np.linalg.norm(toward) * away * radius), side, side)


def assert_like_ours(picture: np.ndarray, seen_from: Camera) -> None:
    """Inside the outline the picture is our path tracer's, and five times nearer than its mirror images and turns."""
    from hir_core.bake import scene_from_asset
    from hir_core.manager import PluginManager
    from hir_core.metrics import composite, unassociate
    from hir_core.reference import reference_renderer, render_view

    _, renderer = reference_renderer(PluginManager.discover(), "", {"render_samples": 64})
    image = render_view(renderer, scene_from_asset(asset()), seen_from, "script")
    ours, inside = composite(*unassociate(image)), image[..., 3] > 0.99
    assert inside.sum() > 5000

    def error(other: np.ndarray) -> float:
        return float(np.abs(other[inside] - ours[inside]).mean())

    assert error(picture) < 0.02
    for wrong in (picture[:, ::-1], picture[::-1], np.rot90(picture), picture[..., ::-1]):
        assert error(wrong) > 5 * error(picture)


def test_the_threejs_page(chromium: list[str], tmp_path: Path) -> None:
    three = module_folder("three")
    if three is None:
        pytest.skip("three.js is not installed: run tools/setup.sh test")
    folder, side = tmp_path / "served", 320
    create_exporter("glb").write(asset(), folder / "octants.glb")
    shutil.copy(SCRIPTS / "threejs.html", folder)
    (folder / "three").symlink_to(three)

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            """Says nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        for budget in (8000, 64_000, 256_000):
            words = [
                *chromium, f"--user-data-dir={tmp_path / 'profile'}", f"--window-size={side},{side}",
                f"--virtual-time-budget={budget}", f"--screenshot={tmp_path / 'shot.png'}",
                f"http://127.0.0.1:{server.server_port}/threejs.html?asset=octants.glb&light=octants.hdr",
            ]  # fmt: skip
            subprocess.run(words, check=True, capture_output=True, timeout=200)
            picture = read_ldr(tmp_path / "shot.png")[..., :3]
            if np.ptp(picture[side // 2], axis=0).max() > 0.2:
                break
        server.shutdown()
    assert_like_ours(picture, camera(4.0, side))


def test_the_blender_script(tmp_path: Path) -> None:
    if not blender_python().exists():
        pytest.skip("bpy is not installed: run tools/setup.sh blender, or set HIR_BLENDER_PYTHON")
    create_exporter("glb").write(asset(), tmp_path / "octants.glb")
    files = [tmp_path / name for name in ("octants.glb", "octants.hdr", "picture.png")]
    words = [blender_python(), SCRIPTS / "blender_import.py", "--", *files]
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True, check=False, timeout=600)
    assert files[2].is_file(), done.stdout[-600:] + done.stderr[-600:]
    picture = read_ldr(files[2])[..., :3]
    assert_like_ours(picture, camera(3.6, len(picture)))
