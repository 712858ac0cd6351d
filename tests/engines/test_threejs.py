"""three.js renders an exported .glb like hir's path tracer: orientation, handedness and colour."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hir_exporters.asset import Asset
from hir_exporters.format_options import GltfConfig
from hir_exporters.formats import create_exporter
from parity.browser import module_folder
from parity.costs import rows
from parity.engines import render_in_browser

from hir_core.metrics import composite, unassociate
from hir_core.plugins.manager import PluginManager
from hir_core.rendering.orbit_cameras import orbit_cameras
from tests.fixtures.octant_asset import asset


@pytest.fixture(scope="module")
def shots(chromium: list[str], tmp_path_factory: pytest.TempPathFactory) -> list[tuple[np.ndarray, np.ndarray]]:
    """Pairs of images over black (H, W, 3), rendered by three.js and by us, from two sides."""
    if module_folder("three") is None:
        pytest.skip("three.js is not installed: run tools/setup.sh test")
    from hir_core.rendering.reference_renderer import reference_renderer, render_view
    from hir_core.scene.asset_conversion import scene_from_asset
    from hir_core.stages.export.asset_export import export_asset

    folder = tmp_path_factory.mktemp("browser")
    plugins = PluginManager.discover()
    export_asset(asset(), ["glb", "hdr"], folder, plugins)
    _, renderer = reference_renderer(plugins, "", {"render_samples": 64})
    cameras = orbit_cameras(6, 25.0, 256)[:3:2]
    theirs = render_in_browser("three.html", folder / "octants.glb", folder / "octants.hdr", cameras)
    scene = scene_from_asset(asset())
    ours = [composite(*unassociate(render_view(renderer, scene, c, f"shot {i}"))) for i, c in enumerate(cameras)]
    return list(zip(theirs, ours, strict=True))


def error(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.abs(a - b).mean())


def test_same_orientation_handedness_and_channels(shots: list[tuple[np.ndarray, np.ndarray]]) -> None:
    """Our image is ten times closer to that of three.js than any mirrored, rotated or channel-swapped one."""
    for rendered, ours in shots:
        wrong = {
            "mirrored": ours[:, ::-1],
            "upside down": ours[::-1],
            "rotated": np.rot90(ours),
            "red for blue": ours[..., ::-1],
        }
        right = error(rendered, ours)
        for name, picture in wrong.items():
            assert error(rendered, picture) > 10 * right, name
    (first, _), (_, second) = shots
    assert error(first, second) > 10 * error(*shots[0]), "the two sides differ"


def test_same_colours(shots: list[tuple[np.ndarray, np.ndarray]]) -> None:
    """Away from edges of colours: within 2 of 255 codes, and no channel brighter or darker by more than 1 %.

    Measured from the first side: 1.1, 1.5 and 0.8 codes, ratios 1.002, 1.000, 1.002. With a wrongly rotated light the
    worst channel differs by 15 codes or more. The remaining difference is three.js' prefiltering of the light.
    """
    for rendered, ours in shots:
        inside = ours.sum(axis=-1) > 0
        flat = inside & (np.abs(np.gradient(ours.mean(axis=-1))).max(axis=0) < 0.01)
        assert flat.sum() > 5000
        assert np.abs(rendered[flat] - ours[flat]).mean(axis=0).max() < 2 / 255
        np.testing.assert_allclose(rendered[flat].mean(axis=0) / ours[flat].mean(axis=0), 1.0, atol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "library"), [("draco", "DracoPy"), ("meshopt", "meshopt")])
def test_compressed_files_give_the_same_image(name: str, library: str, chromium: list[str], tmp_path: Path) -> None:
    """Decoded by three.js: the mean difference is below one code, and the image is neither mirrored nor empty."""
    pytest.importorskip(library, reason="hir[compress] is not installed")
    if module_folder("three") is None:
        pytest.skip("three.js is not installed: run tools/setup.sh test")
    pictures = {}
    for compression in ("none", name):
        file = tmp_path / f"{compression}.glb"
        create_exporter("glb", GltfConfig(compression=compression)).write(asset(), file)
        light = file.with_suffix(".hdr")
        [pictures[compression]] = render_in_browser("three.html", file, light, [orbit_cameras(6, 25.0, 256)[0]])
    assert error(pictures["none"], pictures["none"][:, ::-1]) > 0.02
    assert error(pictures["none"], pictures[name]) < 1 / 255


@pytest.mark.slow
@pytest.mark.usefixtures("ktx2_encoder")
def test_ktx2_gives_nearly_the_same_image(chromium: list[str], tmp_path: Path) -> None:
    """Decoded by three.js, without a fallback in the file: the mean difference is below two codes."""
    if module_folder("three") is None:
        pytest.skip("three.js is not installed: run tools/setup.sh test")

    def without_fallback(document: Any, _: Asset) -> None:
        for texture in document.textures:
            texture.source = None
        document.extensionsRequired.append("KHR_texture_basisu")

    camera = orbit_cameras(6, 25.0, 256)[0]
    create_exporter("glb", GltfConfig()).write(asset(), tmp_path / "png.glb")
    create_exporter("glb", GltfConfig(image_format="ktx2")).write(asset(), tmp_path / "ktx2.glb", without_fallback)
    light = tmp_path / "png.hdr"
    [png], [ktx2] = (render_in_browser("three.html", tmp_path / f"{n}.glb", light, [camera]) for n in ("png", "ktx2"))
    assert error(png, png[:, ::-1]) > 0.02
    assert error(png, ktx2) < 2 / 255


def test_the_page_contains_the_measured_costs(shared: Path) -> None:
    text = (Path(__file__).resolve().parents[2] / "docs" / "engines" / "threejs.md").read_text(encoding="utf-8")
    table = text.split("<!-- costs -->")[1].split("<!-- /costs -->")[0].strip().splitlines()
    assert table[2:] == rows(shared / "envmaps" / "studio.hdr")
