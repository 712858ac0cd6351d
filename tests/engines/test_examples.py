"""The scripts of examples/engines, run unchanged."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.formats import create_exporter
from hir_exporters.textures.image_files import read_ldr
from parity.browser import module_folder, pictures_in_browser
from parity.engines import blender_python

from hir_core.capture import Camera
from hir_core.rendering.orbit_cameras import look_at
from tests.fixtures.octant_asset import asset

SCRIPTS = Path(__file__).resolve().parents[2] / "examples" / "engines"

pytestmark = pytest.mark.slow


def camera(away: float, width: int, height: int) -> Camera:
    """The camera of both scripts: 35° vertical field of view, `away` bounding-sphere radii along (0.5, 0.4, 1)."""
    radius = float(np.linalg.norm([0.9, 0.6, 0.7]))
    toward = np.array([0.5, 0.4, 1.0])
    focal = height / 2 / np.tan(np.radians(17.5))
    intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    return Camera(intrinsics, look_at(toward / np.linalg.norm(toward) * away * radius), width, height)


def assert_like_ours(picture: np.ndarray, seen_from: Camera) -> None:
    """Inside the silhouette the image matches our path tracer; mirrored and rotated ones have five times its error."""
    from hir_core.metrics import composite, unassociate
    from hir_core.plugins.manager import PluginManager
    from hir_core.rendering.reference_renderer import reference_renderer, render_view
    from hir_core.scene.asset_conversion import scene_from_asset

    _, renderer = reference_renderer(PluginManager.discover(), "", {"render_samples": 64})
    image = render_view(renderer, scene_from_asset(asset()), seen_from, "script")
    ours, inside = composite(*unassociate(image)), image[..., 3] > 0.99
    assert inside.sum() > 5000

    def error(other: np.ndarray) -> float:
        return float(np.abs(other[inside] - ours[inside]).mean())

    assert error(picture) < 0.02
    for wrong in (picture[:, ::-1], picture[::-1], picture[::-1, ::-1], picture[..., ::-1]):
        assert error(wrong) > 5 * error(picture)


ANSWER = """<script>
(async () => {
  while (document.documentElement.dataset.ready !== "yes") await new Promise((done) => setTimeout(done, 50));
  const canvas = document.querySelector("canvas");
  await fetch("/picture/0", { method: "POST", body: await new Promise((done) => canvas.toBlob(done, "image/png")) });
})();
</script>"""


def test_the_threejs_page(chromium: list[str], tmp_path: Path) -> None:
    """Unchanged but for the path of three.js; a script before it sets the URL's parameters."""
    if module_folder("three") is None:
        pytest.skip("three.js is not installed: run tools/setup.sh test")
    create_exporter("glb").write(asset(), tmp_path / "octants.glb")
    page = (SCRIPTS / "threejs.html").read_text(encoding="utf-8")
    assert page.count("./three/build/") == page.count("./three/examples/") == 1
    page = page.replace("./three/build/", "/modules/three/build/").replace(
        "./three/examples/", "/modules/three/examples/"
    )
    address = "<script>history.replaceState(null, '', '?asset=octants.glb&light=octants.hdr')</script>"
    (tmp_path / "page.html").write_text(page.replace("<title>", address + "<title>") + ANSWER, encoding="utf-8")
    served = {f"/{name}": (tmp_path / name).read_bytes() for name in ("octants.glb", "octants.hdr")}
    [picture] = pictures_in_browser(chromium, tmp_path / "page.html", [{}], served)
    height, width = picture.shape[:2]
    assert_like_ours(picture[..., :3], camera(4.0, width, height))


def test_the_blender_script(tmp_path: Path) -> None:
    if not blender_python().exists():
        pytest.skip("bpy is not installed: run tools/setup.sh blender, or set HIR_BLENDER_PYTHON")
    create_exporter("glb").write(asset(), tmp_path / "octants.glb")
    files = [tmp_path / name for name in ("octants.glb", "octants.hdr", "picture.png")]
    words = [blender_python(), SCRIPTS / "blender_import.py", "--", *files]
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True, check=False, timeout=600)
    assert files[2].is_file(), done.stdout[-600:] + done.stderr[-600:]
    picture = read_ldr(files[2])[..., :3]
    assert_like_ours(picture, camera(3.6, picture.shape[1], picture.shape[0]))
