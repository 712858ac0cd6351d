"""The benchmark of `hir delight`: made scans have the cameras, the surface and the colours of their capture."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hir_exporters.textures.image_files import read_ldr, write_png

from benchmarks import delighted_scan
from benchmarks.delighted_scan import CAMERA_FILES, keeps_triangles, make_scan, table
from hir_core.plugins.manager import PluginManager

COLOR = np.array([0.8, 0.4, 0.2], np.float32)


@pytest.fixture(scope="module")
def uniform_capture(tiny_capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Photographs of one colour, and a ball as the true mesh."""
    folder = tmp_path_factory.mktemp("uniform") / "capture"
    shutil.copytree(tiny_capture, folder)
    for file in (folder / "train").glob("*.png"):
        picture = np.ones((64, 64, 4), np.float32)
        picture[..., :3] = COLOR
        write_png(file, picture)
    ball = trimesh.creation.icosphere(2, 0.4)
    ball.export(folder / "reference.obj")
    return folder


@pytest.mark.parametrize("program", CAMERA_FILES)
def test_a_made_scan_is_that_of_its_capture(
    uniform_capture: Path, tmp_path: Path, program: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`make_scan` itself compares the cameras that a reader finds with those of the capture."""
    monkeypatch.setattr(delighted_scan, "TEXTURE_SIDE", 128)
    make_scan(uniform_capture, tmp_path, program, PluginManager.discover())
    names = {file.stem for file in (uniform_capture / "train").glob("*.png")}
    assert {file.stem for file in (tmp_path / "photos").glob("*.png")} >= names
    scan = trimesh.load(tmp_path / "scan.obj", process=False, force="mesh")
    truth = trimesh.load(uniform_capture / "reference.obj", process=False, force="mesh")
    assert isinstance(scan, trimesh.Trimesh) and isinstance(truth, trimesh.Trimesh)
    np.testing.assert_allclose(scan.triangles, truth.triangles, atol=1e-6)
    texture = read_ldr(tmp_path / "scan.png")[..., :3]
    colored = texture[texture.max(axis=-1) > 0]
    # texels that no photograph shows stay black, those of charts that one shows have its colour
    assert len(colored) > 0.2 * texture.shape[0] ** 2
    assert (np.abs(colored - COLOR).max(axis=-1) < 0.01).mean() > 0.9


def test_cameras_of_another_reader_are_noticed(
    uniform_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(delighted_scan, "TEXTURE_SIDE", 128)
    monkeypatch.setattr(delighted_scan, "FILM_WIDTH_MM", 35.0)
    with pytest.raises(AssertionError):
        make_scan(uniform_capture, tmp_path, "reality_capture", PluginManager.discover())


def test_triangles_in_another_order_are_noticed(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(1)
    uv = np.random.default_rng(0).random((len(ball.vertices), 2))
    for name, faces in (("a", ball.faces), ("b", ball.faces), ("c", ball.faces[::-1])):
        visual = trimesh.visual.TextureVisuals(uv=uv)
        trimesh.Trimesh(ball.vertices, faces, visual=visual, process=False).export(tmp_path / f"{name}.glb")
    assert keeps_triangles(tmp_path / "a.glb", tmp_path / "b.glb")
    assert not keeps_triangles(tmp_path / "a.glb", tmp_path / "c.glb")


def test_the_table_says_what_rows_say() -> None:
    decibels = {"frame": 40.0, "object": 30.0}
    row = {
        "capture": "ball",
        "seconds": 200.4,
        "model": "specular",
        "unseen": decibels,
        "albedo": None,
        "relit": {"relight_0": decibels, "relight_1": decibels | {"object": 31.0}},
        "baked": {"relight_0": decibels | {"object": 20.0}, "relight_1": decibels | {"object": 21.0}},
    }
    assert table([json.loads(json.dumps(row))]).splitlines()[2] == (
        "| ball | 200 | specular | 30.0 | – | 20.0 | 30.0 | 21.0 | 31.0 |"
    )
