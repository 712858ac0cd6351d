"""`hir delight`: the scan's mesh and texture coordinates stay, masks come from its silhouette."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from hir_core.cli import main
from hir_core.pipeline import Run
from hir_core.run.run_directory import RunDirectory
from tests.fixtures.runs import QUICK

FIT = [word for setting in QUICK if setting.startswith("reflectance") for word in ("--set", setting)]


def scan_of(run: Run) -> Path:
    """The exported asset of a run, as another program's scan: +Y up, with texture coordinates."""
    return next((run.directory.path / "exports").glob("*.glb"))


def delight(scan: Path, photos: Path, run: Path, *options: str) -> int:
    arguments = ["delight", str(scan), str(photos), "-o", str(run), "--set", "atlas.texture_size=64", *FIT, *options]
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    return int(ended.value.code or 0)


def corners(file: Path) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Positions (F, 3, 3) and texture coordinates (F, 3, 2) of the triangles, in their order."""
    mesh = trimesh.load(file, process=False, force="mesh")
    assert isinstance(mesh, trimesh.Trimesh)
    uv = np.asarray(mesh.visual.uv, np.float32)  # type: ignore[union-attr]
    return np.asarray(mesh.vertices, np.float32)[mesh.faces], uv[mesh.faces]


def test_mesh_and_coordinates_stay(finished: Run, tiny_capture: Path, tmp_path: Path) -> None:
    scan = scan_of(finished)
    assert delight(scan, tiny_capture, tmp_path / "run", "--set", 'export=["glb"]') == 0
    exported = next((tmp_path / "run" / "exports").glob("*.glb"))
    (positions, uvs), (old_positions, old_uvs) = corners(exported), corners(scan)
    assert uvs.tobytes() == old_uvs.tobytes()
    np.testing.assert_allclose(positions, old_positions, atol=1e-6)
    document = RunDirectory(tmp_path / "run").read_run()
    assert document["stages"]["initializer"]["report"]["initializers"] == ["mesh_file"]
    assert document["stages"]["atlas"]["report"]["charts"] is None


def test_photographs_without_masks_get_those_of_the_scan(finished: Run, tiny_capture: Path, tmp_path: Path) -> None:
    from hir_core.intake.mask_sources import apply_mask_sources
    from hir_core.intake.reader_lookup import read_capture
    from hir_core.plugins.manager import PluginManager
    from hir_plugins.initializers.existing_mesh.mesh_file import MeshFile
    from hir_plugins.initializers.options import MeshFileOptions

    plugins = PluginManager.discover()
    capture = read_capture(tiny_capture, "train", plugins)
    _, scene = MeshFile(MeshFileOptions(path=str(scan_of(finished)))).initialize(capture, None, tmp_path)
    masked = apply_mask_sources(capture, scene, ["mesh_silhouette"], {}, plugins, known="mesh")
    for view, true in zip(masked.views, capture.views, strict=True):
        found, expected = view.pixels().mask, true.pixels().mask
        assert found is not None and expected is not None
        # the scan is the quick fit of a few pictures of 64²
        assert np.minimum(found, expected).sum() > 0.85 * np.maximum(found, expected).sum()


def test_named_sources_do_not_replace_what_an_earlier_one_found(tiny_capture: Path) -> None:
    from hir_core.intake.mask_sources import apply_mask_sources
    from hir_core.intake.reader_lookup import read_capture
    from hir_core.plugins.manager import PluginManager

    plugins = PluginManager.discover()
    names = ["alpha", "mesh_silhouette"]
    capture = read_capture(tiny_capture, "train", plugins)
    first = apply_mask_sources(capture, None, names, {}, plugins, known="photographs")
    assert all(view.mask is not None for view in first.views)
    # without a scene the second would raise
    assert apply_mask_sources(first, None, names, {}, plugins, known="mesh").views == first.views


def test_no_photograph_is_decoded_for_a_moment_without_sources(tiny_capture: Path) -> None:
    from dataclasses import replace

    from hir_core.capture import Pixels
    from hir_core.intake.mask_sources import apply_mask_sources
    from hir_core.intake.reader_lookup import read_capture
    from hir_core.plugins.manager import PluginManager

    def unread() -> Pixels:
        raise AssertionError("a photograph was decoded")

    plugins = PluginManager.discover()
    capture = read_capture(tiny_capture, "train", plugins)
    capture = replace(capture, views=tuple(replace(view, read=unread) for view in capture.views))
    assert apply_mask_sources(capture, None, "auto", {}, plugins, known="mesh") is capture


@pytest.mark.parametrize("broken", ["no coordinates", "overlap"])
def test_coordinates_that_cannot_be_kept_are_an_error(
    finished: Run, tiny_capture: Path, tmp_path: Path, broken: str, capsys: pytest.CaptureFixture[str]
) -> None:
    mesh = trimesh.load(scan_of(finished), process=False, force="mesh")
    assert isinstance(mesh, trimesh.Trimesh)
    scan = tmp_path / "scan.glb"
    if broken == "overlap":
        mesh.visual.uv = np.asarray(mesh.visual.uv) * 0.1  # type: ignore[union-attr]
        mesh.visual.uv[::2] += 0.5  # type: ignore[union-attr]
    else:
        mesh.visual = trimesh.visual.ColorVisuals(mesh)
    mesh.export(scan)
    assert delight(scan, tiny_capture, tmp_path / "run") != 0
    words = "overlap or leave" if broken == "overlap" else "no texture coordinates"
    output = capsys.readouterr()
    assert words in output.err and "unwrap it" in output.err


def test_photographs_without_cameras_are_aligned_with_the_scan(tiny_capture: Path, tmp_path: Path) -> None:
    from hir_core.plugins.manager import PluginManager
    from hir_plugins.commands.delight.command import scan_settings

    plugins = PluginManager.discover()
    shutil.copytree(tiny_capture / "train", tmp_path / "photos")
    scan = tmp_path / "scan.obj"
    known = scan_settings(scan, tiny_capture, "source", None, plugins)
    assert known == [f'initializer.mesh_file.path="{scan}"', 'initializer.mesh_file.axes="source"']
    for align, last in (
        (None, 'initializer.mesh_file.align="points"'),
        (False, 'initializers=["colmap", "mesh_file"]'),
    ):
        assert scan_settings(scan, tmp_path / "photos", "auto", align, plugins)[-1] == last
    assert len(scan_settings(scan, tiny_capture, "auto", True, plugins)) == 4
