"""The page of `hir view --save`, opened from disk in a browser: the asset, each channel, a rotated light."""

from __future__ import annotations

import json
import re
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.asset import Asset, AssetMaterial
from hir_exporters.conventions import direction_to_latlong_uv, linear_to_srgb, srgb_to_linear
from hir_exporters.files.atomic import write_text_atomic
from hir_exporters.formats import create_exporter
from hir_exporters.scene_format import save_scene
from hir_exporters.textures.image_files import read_ldr, write_png
from parity.browser import pictures_in_browser

from hir_core.capture import Camera
from hir_core.cli import main
from hir_core.errors import InputError
from hir_core.rendering.orbit_cameras import look_at
from hir_plugins.commands.viewer.three_modules import three_version
from hir_plugins.commands.viewer.viewer_page import view_page
from tests.fixtures.browser_session import BrowserSession
from tests.fixtures.octant_asset import asset

SIDE = 320
BACKGROUND = np.array([0x17, 0x18, 0x1B])

Shot = Callable[..., np.ndarray]


def glossy() -> Asset:
    """The octants with a known roughness: sqrt(0.16) = 0.4."""
    plain = asset()
    return replace(plain, material=replace(plain.material, roughness=np.array(0.16, np.float32)))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page saved by the command from an exported .glb and the .hdr beside it."""
    folder = tmp_path_factory.mktemp("view")
    create_exporter("glb").write(glossy(), folder / "octants.glb")
    with pytest.raises(SystemExit) as stop:
        main(["view", str(folder / "octants.glb"), "--save", str(folder / "page.html"), "-q"])
    assert stop.value.code == 0
    return folder / "page.html"


@pytest.fixture(scope="module")
def browser(chromium: list[str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[BrowserSession]:
    folder = tmp_path_factory.mktemp("browser")
    with BrowserSession(chromium, folder / "profile", folder, (SIDE, SIDE)) as session:
        yield session


@pytest.fixture(scope="module")
def shot(browser: BrowserSession, tmp_path_factory: pytest.TempPathFactory) -> Shot:
    """A picture (SIDE, SIDE, 3), sRGB in 0…1, of the page opened from disk with settings after the #."""
    path = tmp_path_factory.mktemp("shots") / "shot.png"

    def take(page: Path, settings: str) -> np.ndarray:
        browser.send("Page.navigate", url="about:blank")  # or else nothing is loaded where only the settings differ
        browser.open(f"{page.as_uri()}#bare&{settings}")
        deadline = time.monotonic() + 120
        while time.monotonic() < deadline:
            browser.screenshot(path)
            picture = read_ldr(path)[..., :3]
            if np.abs(picture[SIDE // 2, SIDE // 2] * 255 - BACKGROUND).max() > 2:
                return picture
            time.sleep(0.05)
        raise AssertionError("the page drew nothing")

    return take


def first_camera() -> Camera:
    """The page's first camera, from its own formula: the sphere about the box, 35° high, 1.15 radii to spare."""
    radius = float(np.linalg.norm([0.9, 0.6, 0.7]))
    toward = np.array([0.55, 0.35, 1.0])
    position = toward / np.linalg.norm(toward) * 1.15 * radius / np.sin(np.radians(17.5))
    focal = SIDE / 2 / np.tan(np.radians(17.5))
    return Camera(np.array([[focal, 0, SIDE / 2], [0, focal, SIDE / 2], [0, 0, 1.0]]), look_at(position), SIDE, SIDE)


@pytest.mark.slow
def test_lit_picture_is_our_render_and_its_light_turns(page: Path, shot: Shot) -> None:
    from hir_core.metrics import composite, unassociate
    from hir_core.plugins.manager import PluginManager
    from hir_core.rendering.reference_renderer import reference_renderer, render_view
    from hir_core.scene.asset_conversion import scene_from_asset

    _, renderer = reference_renderer(PluginManager.discover(), "", {"render_samples": 64})
    image = render_view(renderer, scene_from_asset(glossy()), first_camera(), "page")
    ours, inside = composite(*unassociate(image)), image[..., 3] > 0.99
    assert inside.sum() > 10_000

    def error(picture: np.ndarray) -> float:
        return float(np.abs(picture[inside] - ours[inside]).mean())

    right, turned = error(shot(page, "")), error(shot(page, "rotation=120"))
    assert right < 0.02, "edges of colours and three.js' prefiltered light"
    assert turned > 3 * right


@pytest.mark.slow
def test_the_light_is_switched_and_displayed_as_background(page: Path, shot: Shot) -> None:
    """Under the uniform light a diffuse surface has 0.8 of its albedo; the background is the light of its direction."""
    uniform, albedo = (srgb_to_linear(shot(page, settings)) for settings in ("light=uniform", "channel=albedo"))
    inside = (albedo > 0.02).all(axis=-1)  # the background is 0.01
    assert inside.sum() > 10_000
    np.testing.assert_allclose(np.median(uniform[inside] / albedo[inside], axis=0), 0.8, atol=0.02)

    environment, camera = glossy().environment, first_camera()
    shown = shot(page, "background")
    for x, y in ((4, 4), (SIDE - 5, 6), (5, SIDE - 6), (SIDE - 6, SIDE - 5)):
        ray = np.linalg.inv(camera.intrinsics) @ [x + 0.5, y + 0.5, 1]
        u, v = direction_to_latlong_uv(camera.world_to_camera[:3, :3].T @ ray)
        height, width = environment.radiance.shape[:2]
        meant = linear_to_srgb(np.minimum(environment.radiance[int(v * height), int(u * width) % width], 1))
        np.testing.assert_allclose(shown[y, x], meant, atol=0.02)


ANSWER = """<script>
(async () => {
  const root = document.documentElement, canvas = document.getElementById("canvas");
  const pause = (milliseconds) => new Promise((done) => setTimeout(done, milliseconds));
  while (root.dataset.ready !== "yes") await pause(50);
  canvas.setPointerCapture = canvas.releasePointerCapture = () => {}; // only real pointers can be captured
  const at = (kind, x) => canvas.dispatchEvent(new PointerEvent(kind, {
    pointerId: 1, pointerType: "mouse", button: 0, buttons: 1, clientX: x, clientY: 300, bubbles: true,
  }));
  at("pointerdown", 10);
  at("pointermove", 10 + DRAG * innerHeight);
  at("pointerup", 10 + DRAG * innerHeight);
  let before = "", now = canvas.toDataURL();
  while (before !== now) { // damping continues the rotation
    await pause(400);
    [before, now] = [now, canvas.toDataURL()];
  }
  const body = await (await fetch(now)).blob();
  await fetch("/picture/0", { method: "POST", body });
})();
</script></body>"""


@pytest.mark.slow
def test_a_drag_over_half_the_height_rotates_by_half_a_turn(page: Path, chromium: list[str], tmp_path: Path) -> None:
    text = page.read_text(encoding="utf-8")

    def screenshot(drag: float, toward: str) -> np.ndarray:
        changes = {
            "connect-src blob: data:": "connect-src blob: data: 'self'",
            '"initialDirection": null': f'"initialDirection": {toward}',
            "</title>": "</title><script>location.hash = 'bare&channel=albedo'</script>",
            "</body>": ANSWER.replace("DRAG", str(drag)),
        }
        changed = text
        for old, new in changes.items():
            assert changed.count(old) == 1, old
            changed = changed.replace(old, new)
        (tmp_path / "page.html").write_text(changed, encoding="utf-8")
        [picture] = pictures_in_browser(chromium, tmp_path / "page.html", [{}], {})
        return picture[..., :3]

    front, back, dragged = screenshot(0, "null"), screenshot(0, "[-0.55, 0.35, -1]"), screenshot(0.5, "null")
    assert np.abs(back - front).mean() > 0.02, "the two sides differ"
    assert np.abs(dragged - back).mean() < 0.05 * np.abs(dragged - front).mean()


def test_channels_show_the_maps(page: Path, shot: Shot) -> None:
    albedo = shot(page, "channel=albedo&rotation=120")
    palette = linear_to_srgb(glossy().material.diffuse_albedo.reshape(-1, 3))
    palette = np.unique(np.rint(palette * 255), axis=0)
    seen = np.rint(albedo.reshape(-1, 3) * 255)
    found = [color for color in palette if (np.abs(seen - color).max(axis=1) <= 1).sum() > 200]
    assert len(found) >= 3, "the octants that face this camera"
    middle = shot(page, "channel=roughness")[SIDE // 2, SIDE // 2]
    np.testing.assert_allclose(middle, 0.4, atol=1.5 / 255)
    wires = shot(page, "channel=roughness&wireframe")
    assert np.ptp(wires[SIDE // 2 - 40 : SIDE // 2 + 40, SIDE // 2], axis=0).max() > 0.1
    normals = shot(page, "channel=normals")[SIDE // 2, SIDE // 2]
    assert normals[2] > 0.8, "the middle faces the camera"


def test_metalness_is_a_channel(shot: Shot, tmp_path: Path) -> None:
    metal = AssetMaterial.metallic([0.9, 0.6, 0.2], 0.75, 0.16)
    create_exporter("glb").write(replace(asset(), material=metal), tmp_path / "metal.glb")
    with pytest.raises(SystemExit) as stop:
        main(["view", str(tmp_path / "metal.glb"), "--save", str(tmp_path / "page.html"), "-q"])
    assert stop.value.code == 0
    middle = shot(tmp_path / "page.html", "channel=metalness")[SIDE // 2, SIDE // 2]
    np.testing.assert_allclose(middle, 0.75, atol=1.5 / 255)


@pytest.mark.slow
def test_a_photograph_is_displayed_beside_the_asset(chromium: list[str], tmp_path: Path) -> None:
    """The photograph of this run is our own render: both halves of the window show the same image."""
    from hir_core.metrics import composite, unassociate
    from hir_core.plugins.manager import PluginManager
    from hir_core.rendering.reference_renderer import reference_renderer, render_view
    from hir_core.scene.asset_conversion import scene_from_asset

    plain = first_camera()
    shifted = np.add(plain.intrinsics, [[0, 0, -30.0], [0, 0, 14.0], [0, 0, 0]])  # the principal point off the middle
    camera = Camera(shifted, look_at(np.array([-1.5, 1.2, -3.0])), SIDE, SIDE)
    _, renderer = reference_renderer(PluginManager.discover(), "", {"render_samples": 64})
    photograph = composite(*unassociate(render_view(renderer, scene_from_asset(glossy()), camera, "photograph")))
    save_scene(glossy(), tmp_path / "run" / "scene")
    write_png(tmp_path / "run" / "report" / "side_true.png", photograph)
    view = {
        "name": "side",
        "registered": True,
        "split": "train",
        "width": SIDE,
        "height": SIDE,
        "distortion": [],
        "K": shifted.tolist(),
        "world_to_camera": camera.world_to_camera.tolist(),
    }
    write_text_atomic(tmp_path / "run" / "capture" / "cameras.json", json.dumps({"views": [view]}))
    (tmp_path / "page.html").write_text(view_page(tmp_path / "run"), encoding="utf-8")
    for budget in (16_000, 64_000, 256_000):
        words = [
            *chromium,
            f"--user-data-dir={tmp_path / 'profile'}",
            f"--window-size={2 * SIDE},{SIDE}",
            f"--virtual-time-budget={budget}",
            f"--screenshot={tmp_path / 'shot.png'}",
            f"{(tmp_path / 'page.html').as_uri()}#bare&photograph=side",
        ]
        subprocess.run(words, check=True, capture_output=True, timeout=120)
        picture = read_ldr(tmp_path / "shot.png")[..., :3]
        if picture[:, SIDE:].max() > 0.2:
            break
    shown, beside = picture[:, :SIDE], picture[:, SIDE:]
    inside = (photograph.sum(-1) > 0.1) & (shown.sum(-1) > 0.4)
    assert np.abs(beside - photograph).max() < 2 / 255
    assert inside.sum() > 0.97 * (photograph.sum(-1) > 0.1).sum() > 5000
    right, mirrored = (np.abs(p - photograph)[inside].mean() for p in (shown, shown[:, ::-1]))
    assert right < 0.03 and mirrored > 3 * right, (right, mirrored)


def test_the_page_is_self_contained_and_contains_the_licence(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert "connect-src blob: data:" in text and "default-src 'none'" in text, "the page cannot reach the network"
    assert not re.findall(r'(?:src|href)="', text) and not re.findall(
        r"\{[{%]", text.split("<canvas")[1].split("<script")[0]
    )
    assert "The MIT License" in text and f"three.js {three_version()}" in text
    assert len(text) < 2_000_000


def test_other_formats_and_scenes_are_converted_to_glb(tmp_path: Path) -> None:
    create_exporter("usdz").write(glossy(), tmp_path / "octants.usdz")
    save_scene(glossy(), tmp_path / "scene")
    for source in (tmp_path / "octants.usdz", tmp_path / "scene", tmp_path):
        page = view_page(source)
        assert 'id="part asset.glb"' in page and 'id="part light.hdr"' in page
    with pytest.raises(InputError, match="cannot be displayed"):
        view_page(Path(__file__))
    with pytest.raises(InputError, match="does not exist"):
        view_page(tmp_path / "none.glb")


def test_a_page_is_served_on_the_loopback_interface() -> None:
    import threading
    import urllib.error
    import urllib.parse
    import urllib.request

    from hir_plugins.commands.viewer.page_server import serve

    address: list[str] = []
    ready = threading.Event()
    threading.Thread(
        target=serve,
        args=("<p>ä</p>",),
        kwargs={"on_ready": lambda started: (address.append(started.address), ready.set())},
        daemon=True,
    ).start()
    assert ready.wait(10) and address[0].startswith("http://127.0.0.1:")
    with urllib.request.urlopen(address[0]) as answer:
        assert answer.read().decode() == "<p>ä</p>" and "utf-8" in answer.headers["Content-Type"]
    with pytest.raises(urllib.error.HTTPError, match="404") as missing:
        urllib.request.urlopen(address[0] + "else")
    missing.value.close()
    with pytest.raises(InputError, match="cannot be used"):
        serve("", urllib.parse.urlsplit(address[0]).port or 0)
