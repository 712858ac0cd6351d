"""glTF scans of projects whose world is turned upright: in which axes the file is meant."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from hir_core.capture import Capture
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.testing.captures import surface_mesh, tiny_capture
from hir_plugins.initializers.existing_mesh.mesh_file import MeshFile
from hir_plugins.initializers.existing_mesh.scan_axes import axes_of_gltf, world_from_axes
from hir_plugins.initializers.options import MeshFileOptions
from hir_plugins.readers.parsing.camera_axes import WORLD_FROM_Z_UP

AXES = ("source_y_up", "world", "source")


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """A project that is +Z up; its reader turned it about the vertical by an angle of its own."""
    turned = np.eye(4)
    turned[0, 0] = turned[2, 2] = np.cos(0.9)
    turned[0, 2], turned[2, 0] = np.sin(0.9), -np.sin(0.9)
    made = tiny_capture(tmp_path_factory.mktemp("made"), 12, 96).capture
    return replace(made, world_from_source=turned @ WORLD_FROM_Z_UP)


def scan_in(axes: str, capture: Capture) -> tuple[np.ndarray, np.ndarray]:
    mesh = surface_mesh().mesh
    file_from_world = np.linalg.inv(world_from_axes(axes, capture))
    return mesh.positions.double().numpy() @ file_from_world[:3, :3].T, mesh.faces.numpy()


@pytest.mark.parametrize("axes", AXES)
def test_a_gltf_is_read_in_the_axes_that_the_photographs_show(axes: str, capture: Capture, tmp_path: Path) -> None:
    positions, faces = scan_in(axes, capture)
    trimesh.Trimesh(positions, faces, process=False).export(tmp_path / "scan.glb")
    reader = MeshFile(MeshFileOptions(path=str(tmp_path / "scan.glb")))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        _, scene = reader.initialize(capture, None, tmp_path)
    assert scene is not None and reader.report()["axes"] == axes
    queries = MeshQueries(scene.mesh.positions.numpy(), scene.mesh.faces.numpy())
    assert queries.nearest(surface_mesh().mesh.positions.double().numpy())[0].max() < 1e-5


def test_other_formats_and_given_axes_are_not_compared(capture: Capture, tmp_path: Path) -> None:
    positions, faces = scan_in("world", capture)
    for name, axes, expected in (("scan.ply", "auto", "source"), ("scan.glb", "source", "source")):
        trimesh.Trimesh(positions, faces, process=False).export(tmp_path / name)
        reader = MeshFile(MeshFileOptions(path=str(tmp_path / name), axes=axes))  # type: ignore[arg-type]
        _, scene = reader.initialize(capture, None, tmp_path)
        assert scene is not None and "axes" not in reader.report()
        moved = positions @ world_from_axes(expected, capture)[:3, :3].T
        np.testing.assert_allclose(np.ptp(scene.mesh.positions.numpy(), axis=0), np.ptp(moved, axis=0), atol=1e-5)


def test_a_world_that_is_z_up_leaves_no_choice(capture: Capture) -> None:
    """As of transforms.json: +Y up is the world of the run."""
    upright = replace(capture, world_from_source=WORLD_FROM_Z_UP.copy())
    comparison = axes_of_gltf(*scan_in("world", upright), upright)
    assert comparison.axes == "world" and comparison.clear and not comparison.disagreement
    assert axes_of_gltf(*scan_in("world", capture), replace(capture, views=())).axes == "world"


def test_a_plain_ball_looks_the_same_in_all_axes(capture: Capture) -> None:
    ball = trimesh.creation.icosphere(3, 0.6)
    grey = [
        replace(v, read=lambda v=v: replace(v.pixels(), color_linear=np.full((96, 96, 3), 0.2))) for v in capture.views
    ]
    with pytest.warns(UserWarning, match="do not show which axes the scan has .source_y_up, world, source fit as well"):
        comparison = axes_of_gltf(ball.vertices, ball.faces, replace(capture, views=tuple(grey)))
    assert comparison.axes == "source_y_up" and not comparison.clear


def test_a_scan_that_no_photograph_shows_is_a_warning(capture: Capture) -> None:
    positions, faces = scan_in("world", capture)
    with pytest.warns(UserWarning, match="show too little of the scan in any axes"):
        assert not axes_of_gltf(positions + 100, faces, capture).clear
