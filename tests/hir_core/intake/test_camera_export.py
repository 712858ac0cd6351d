"""Cameras written for other programs, read back by our own readers: a known point lands on the same pixel."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hir_core.capture import Camera
from hir_core.errors import ConfigError
from hir_core.intake.camera_export import export_cameras
from hir_core.plugins import NoOptions
from hir_plugins.readers.colmap_model import ColmapModelReader
from hir_plugins.readers.transforms_json import TransformsJsonReader
from tests.fixtures.silhouette_captures import look_at

POINTS = np.array([[0.1, -0.2, 0.3], [-0.3, 0.1, 0.0], [0.0, 0.25, -0.1]])


@pytest.fixture
def solved(tmp_path: Path) -> tuple[dict[str, Camera], dict[str, Path]]:
    (tmp_path / "images").mkdir()
    cameras, photographs = {}, {}
    for i, place in enumerate(np.array([[3.0, 0.4, 0.2], [0.3, 1.0, 2.6], [-2.0, -0.7, 1.5]])):
        name = f"p{i}"
        camera = look_at(place, np.zeros(3), 80.0, 64, 48)
        cameras[name] = replace(camera, distortion=(0.05, -0.01, 0.001, 0.0) if i == 1 else ())
        photographs[name] = tmp_path / "images" / f"{name}.png"
        Image.fromarray(np.zeros((48, 64, 3), np.uint8)).save(photographs[name])
    return cameras, photographs


@pytest.mark.parametrize("form", ["transforms", "colmap"])
def test_cameras_survive_the_way_out_and_in(
    solved: tuple[dict[str, Camera], dict[str, Path]], form: str, tmp_path: Path
) -> None:
    cameras, photographs = solved
    written = export_cameras(cameras, photographs, form, tmp_path)
    assert written.exists()
    reader = (TransformsJsonReader if form == "transforms" else ColmapModelReader)(NoOptions())
    capture = reader.read(tmp_path)
    assert [view.name for view in capture.views] == sorted(cameras)
    # a reader may turn the world; how, it says: transforms are +Z up, COLMAP's as they were
    y_up = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) if form == "transforms" else np.eye(3)
    world = (POINTS @ y_up.T) @ capture.world_from_source[:3, :3].T + capture.world_from_source[:3, 3]
    for view in capture.views:
        assert view.camera is not None
        np.testing.assert_allclose(view.camera.project(world)[0], cameras[view.name].project(POINTS)[0], atol=1e-6)
        expected = np.zeros(8)
        expected[: len(cameras[view.name].distortion)] = cameras[view.name].distortion
        np.testing.assert_allclose([*view.distortion, *[0.0] * 8][:8], expected)


def test_what_cannot_be_written_is_said(solved: tuple[dict[str, Camera], dict[str, Path]], tmp_path: Path) -> None:
    cameras, photographs = solved
    with pytest.raises(ConfigError, match="transforms or colmap"):
        export_cameras(cameras, photographs, "bundler", tmp_path)
    with pytest.raises(ConfigError, match="p1"):
        export_cameras(cameras, {k: v for k, v in photographs.items() if k != "p1"}, "colmap", tmp_path)


def test_takes_survive_the_way_out_and_in(solved: tuple[dict[str, Camera], dict[str, Path]], tmp_path: Path) -> None:
    takes = {"p0": "standing", "p1": "upside_down", "p2": "standing"}
    export_cameras(*solved, "transforms", tmp_path, takes)
    assert {view.name: view.take for view in TransformsJsonReader(NoOptions()).read(tmp_path).views} == takes


def test_photographs_of_one_name_in_two_folders_are_different_images(
    solved: tuple[dict[str, Camera], dict[str, Path]], tmp_path: Path
) -> None:
    cameras, photographs = solved
    moved = {}
    for name, folder in (("p0", "standing"), ("p1", "standing"), ("p2", "upside_down")):
        moved[name] = tmp_path / "images" / folder / ("002.png" if name == "p1" else "001.png")
        moved[name].parent.mkdir(exist_ok=True)
        photographs[name].rename(moved[name])
    export_cameras(cameras, moved, "colmap", tmp_path)
    (tmp_path / "takes.toml").write_text('takes = ["standing", "upside_down"]')
    capture = ColmapModelReader(NoOptions()).read(tmp_path)
    assert {view.path: view.take for view in capture.views} == {path: path.parent.name for path in moved.values()}


@pytest.mark.parametrize(
    ("form", "name"),
    [("transforms", "transforms.json"), ("colmap", "sparse/0/images.txt"), ("colmap", "sparse/0/points3D.bin")],
)
def test_cameras_of_other_programs_are_not_overwritten(
    solved: tuple[dict[str, Camera], dict[str, Path]], form: str, name: str, tmp_path: Path
) -> None:
    theirs = tmp_path / "photos" / name
    theirs.parent.mkdir(parents=True)
    theirs.write_text("{}")
    with pytest.raises(ConfigError, match=f"{theirs.name} exists; choose another folder with -o, or move the file"):
        export_cameras(*solved, form, tmp_path / "photos")
    assert [file for file in (tmp_path / "photos").rglob("*") if file.is_file()] == [theirs]
    assert theirs.read_text() == "{}"


@pytest.mark.parametrize("form", ["transforms", "colmap"])
def test_the_same_cameras_may_be_written_again(
    solved: tuple[dict[str, Camera], dict[str, Path]], form: str, tmp_path: Path
) -> None:
    assert export_cameras(*solved, form, tmp_path) == export_cameras(*solved, form, tmp_path)
