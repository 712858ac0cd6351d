"""`hir delight`: the scan's mesh and texture coordinates stay, masks come from its silhouette."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pygltflib
import pytest
import trimesh
from hir_exporters.textures.image_files import write_png
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


def indices(file: Path) -> NDArray[np.int64]:
    """Vertex numbers (F, 3) of the triangles."""
    mesh = trimesh.load(file, process=False, force="mesh")
    assert isinstance(mesh, trimesh.Trimesh)
    return np.asarray(mesh.faces, np.int64)


def stored_uvs(file: Path, low_bits: bool = False) -> NDArray[np.float32]:
    """Texture coordinates (V, 2) of a .glb of one primitive, with the bits that the file has.

    `low_bits` changes the last bit of each in the file first: 1 - (1 - v) has another one where v < 0.5.
    """
    gltf = pygltflib.GLTF2().load(str(file))
    assert gltf is not None
    accessor = gltf.accessors[gltf.meshes[0].primitives[0].attributes.TEXCOORD_0]
    assert accessor.componentType == pygltflib.FLOAT
    view = gltf.bufferViews[accessor.bufferView]
    assert view.byteStride in (None, 8)
    content = bytearray(gltf.binary_blob())
    start = (view.byteOffset or 0) + (accessor.byteOffset or 0)
    uvs = np.frombuffer(content, np.float32, 2 * accessor.count, start).reshape(-1, 2)
    if low_bits:
        uvs[:] = np.nextafter(uvs, np.float32(0.5))
        gltf.set_binary_blob(bytes(content))
        gltf.save(str(file))
    return uvs


def shuffled(file: Path, target: Path) -> Path:
    """The same mesh with its vertices in another order, as another program may write it."""
    mesh = trimesh.load(file, process=False, force="mesh")
    assert isinstance(mesh, trimesh.Trimesh)
    order = np.random.default_rng(0).permutation(len(mesh.vertices))
    uv = np.asarray(mesh.visual.uv)[order]  # type: ignore[union-attr]
    visual = trimesh.visual.TextureVisuals(uv=uv)
    trimesh.Trimesh(mesh.vertices[order], np.argsort(order)[mesh.faces], visual=visual, process=False).export(target)
    return target


def test_mesh_and_coordinates_stay(finished: Run, tiny_capture: Path, tmp_path: Path) -> None:
    scan = shuffled(scan_of(finished), tmp_path / "scan.glb")
    written = stored_uvs(scan, low_bits=True)
    assert (1 - (1 - written[:, 1]) != written[:, 1]).any(), "rounding would show"
    assert delight(scan, tiny_capture, tmp_path / "run", "--set", 'export=["glb"]') == 0
    exported = next((tmp_path / "run" / "exports").glob("*.glb"))
    (positions, uvs), (old_positions, old_uvs) = corners(exported), corners(scan)
    np.testing.assert_allclose(uvs, old_uvs, atol=1e-6)
    assert stored_uvs(exported).tobytes() == stored_uvs(scan).tobytes() == written.tobytes()
    # the file has one vertex for each pair of position and texture coordinate, so its indices stay, too
    assert indices(exported).tobytes() == indices(scan).tobytes()
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


def write_scan(folder: Path, run: Run, fault: str = "") -> Path:
    """The asset of a run as a textured .obj in the axes of the run, with a fault in its coordinates."""
    positions, uvs = corners(scan_of(run))
    half = len(uvs) // 2
    if fault == "UDIM":
        uvs[half:, :, 0] += 1
    elif fault in ("mirrored", "two materials"):
        uvs[half : 2 * half] = uvs[:half]
    lines = ["mtllib scan.mtl", "usemtl m0"]
    lines += [f"v {x} {y} {z}" for x, y, z in positions.reshape(-1, 3).tolist()]
    lines += [f"vt {u} {v}" for u, v in uvs.reshape(-1, 2).tolist()]
    for face in range(len(positions)):
        if face == half and fault == "two materials":
            lines.append("usemtl m1")
        numbers = range(3 * face + 1, 3 * face + 4)
        lines.append("f " + " ".join(f"{n}" if fault == "no coordinates" else f"{n}/{n}" for n in numbers))
    folder.mkdir()
    (folder / "scan.obj").write_text("\n".join(lines) + "\n")
    (folder / "scan.mtl").write_text("newmtl m0\nmap_Kd a.png\nnewmtl m1\nmap_Kd b.png\n")
    for seed, name in enumerate(("a.png", "b.png")):
        write_png(folder / name, np.random.default_rng(seed).integers(0, 256, (32, 32, 3)).astype(np.uint8))
    return folder / "scan.obj"


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("no coordinates", "has no texture coordinates"),
        ("mirrored", "has texture coordinates that overlap (as mirrored halves and several materials have)"),
        ("two materials", "has texture coordinates that overlap (as mirrored halves and several materials have)"),
        ("UDIM", "has texture coordinates outside 0…1 (as UDIM tiles and repeated textures have)"),
    ],
)
def test_coordinates_that_cannot_be_kept_are_an_error(
    finished: Run, tiny_capture: Path, tmp_path: Path, fault: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """One sentence with the file and the remedy; before it, why the textures of two materials are not compared."""
    scan = write_scan(tmp_path / "scan", finished, fault)
    assert delight(scan, tiny_capture, tmp_path / "run", "--axes", "world") != 0
    output = " ".join(capsys.readouterr().err.split())
    assert f"scan.obj {words}, so they cannot be kept; unwrap it" in output
    assert 'texture_coordinates="auto"' in output
    # the path before it may be wrapped
    assert ("has 2 base colours (a.png, b.png)" in output) == (fault == "two materials")


@pytest.mark.slow
def test_a_fit_is_the_same_without_the_texture(finished: Run, tiny_capture: Path, tmp_path: Path) -> None:
    """All that a run finds has the same bits; only its comparison with the scan differs."""
    found: list[dict[str, bytes]] = []
    for name in ("with", "without"):
        scan = write_scan(tmp_path / name, finished)
        if name == "without":
            scan.write_text(scan.read_text().replace("mtllib scan.mtl\n", ""))
        run = tmp_path / f"run {name}"
        options = ("--axes", "world", "--set", "deterministic=true", "--set", 'export=["glb"]')
        assert delight(scan, tiny_capture, run, *options) == 0
        stages = [file for file in (run / "stages").rglob("*") if file.suffix in (".npz", ".exr", ".png")]
        files = [*stages, *(run / "scene").rglob("*"), *(run / "exports").rglob("*")]
        found.append({str(file.relative_to(run)): file.read_bytes() for file in files if file.is_file()})
        kind, other = ("scan", "vertices") if name == "with" else ("vertices", "scan")
        assert (run / "report" / f"relit_{kind}.png").exists() and not (run / "report" / f"relit_{other}.png").exists()
    texture = found[0].pop("stages/1-initializer/scan_texture.png")
    assert texture == (tmp_path / "with" / "a.png").read_bytes()
    assert found[0] == found[1] and len(found[0]) > 6


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


@pytest.mark.parametrize(("scan", "problem"), [("scan.obj", "does not exist"), ("", "is a folder")])
def test_a_missing_scan_leaves_no_run(
    scan: str, problem: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["delight", str(tmp_path / scan), str(tmp_path), "-o", str(tmp_path / "run")])
    assert ended.value.code == 2
    assert f"{problem}; give the mesh file of the scan" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
