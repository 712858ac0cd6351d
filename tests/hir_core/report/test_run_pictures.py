"""Pictures of a finished run, from its own cameras and around it, under its own light and others."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.textures.image_files import read_exr, read_ldr, write_hdr

from hir_core.errors import InputError
from hir_core.pipeline import Run
from hir_core.plugins.manager import PluginManager
from hir_core.rendering.orbit_cameras import orbit_cameras
from hir_core.report.run_pictures import render_pictures
from hir_core.run.capture_store import read_cameras
from hir_core.run.run_directory import RunDirectory

PLUGINS = PluginManager.discover()
FEW = {"render_samples": 8}


def test_cameras_around_see_the_whole_object() -> None:
    for camera in orbit_cameras(3, 35.0, 64):
        away = camera.world_to_camera[:3, 3]
        np.testing.assert_allclose(away[:2], 0, atol=1e-12)
        around = np.random.default_rng(0).normal(size=(500, 3))
        points = around / np.linalg.norm(around, axis=1, keepdims=True) @ camera.world_to_camera[:3, :3].T + away
        pixels = points @ camera.intrinsics.T
        pixels = pixels[:, :2] / pixels[:, 2:]
        assert pixels.min() > 0 and pixels.max() < 64
        assert camera.world_to_camera[1, 1] < 0, "+Y is up in the picture"


def test_pictures_of_a_run(finished: Run, tmp_path: Path) -> None:
    write_hdr(tmp_path / "even.hdr", np.ones((4, 8, 3), np.float32))
    shown = {}
    for strength in ("0.25", "0.5"):
        light, folder = f"{tmp_path / 'even.hdr'}*{strength}", tmp_path / strength
        folder.mkdir()
        output = list(
            render_pictures(finished.directory, PLUGINS, folder, orbit=1, size=16, relight=light, options=FEW, exr=True)
        )
        assert output == [folder / "orbit_000.png", folder / "orbit_000.exr"], "all files are named"
        picture = read_ldr(output[0])
        assert picture.shape == (16, 16, 4) and picture[8, 8, 3] == 1 and picture[0, 0, 3] == 0
        shown[strength] = read_exr(folder / "orbit_000.exr")
    bright, dark = (shown[s][..., :3].mean() for s in ("0.5", "0.25"))
    assert bright == pytest.approx(2 * dark, rel=0.01)


def test_a_view_by_its_name(finished: Run, tiny_capture: Path, tmp_path: Path) -> None:
    name = next(iter(read_cameras(finished.directory.cameras)))
    [output] = render_pictures(finished.directory, PLUGINS, tmp_path, views=(name,), options=FEW)
    shown, photographed = (read_ldr(path)[..., 3] > 0.5 for path in (output, tiny_capture / "train" / output.name))
    assert (shown & photographed).sum() > 0.9 * (shown | photographed).sum()
    with pytest.raises(InputError, match=r"has no view 'nobody'; its views are: "):
        list(render_pictures(finished.directory, PLUGINS, tmp_path, views=("nobody",)))


def test_a_view_with_lens_distortion(finished: Run, tmp_path: Path) -> None:
    """Of a copy of a run whose photographs were distorted: the picture is that of the undistorted photograph."""
    straight, curved = tmp_path / "straight", tmp_path / "curved"
    shutil.copytree(finished.directory.path, tmp_path / "run")
    directory = RunDirectory(tmp_path / "run")
    document = json.loads(directory.cameras.read_text())
    name = document["views"][0]["name"]
    for folder, distortion in ((straight, []), (curved, [0.05, 0.0, 0.0, 0.0])):
        document["views"][0]["distortion"] = distortion
        directory.cameras.write_text(json.dumps(document))
        folder.mkdir()
        list(render_pictures(directory, PLUGINS, folder, views=(name,), options=FEW))
    [first], [second] = straight.iterdir(), curved.iterdir()
    np.testing.assert_array_equal(read_ldr(first), read_ldr(second))
