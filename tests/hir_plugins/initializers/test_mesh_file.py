"""Meshes from files: axes, texture coordinates, broken ones."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hir_exporters.textures.image_files import write_png

from hir_core.capture import Capture, OrientedPoints
from hir_core.errors import CaptureError, ConfigError
from hir_core.scene import Mesh, Scene
from hir_core.scene.scan import Scan
from hir_core.scene.scene_store import save_stage_scene
from hir_plugins.initializers.existing_mesh.mesh_file import MeshFile
from hir_plugins.initializers.options import MeshFileOptions
from hir_plugins.readers.parsing.camera_axes import WORLD_FROM_Z_UP

OBJ = """
v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 2
vt 0 0
vt 1 0
vt 0.25 0.75
vt 0.5 0.5
f 1/1 3/3 2/2
f 1/1 2/2 4/4
f 1/4 4/2 3/3
f 2/1 3/3 4/4
"""


@pytest.fixture
def capture(tmp_path: Path) -> Capture:
    (tmp_path / "mesh.obj").write_text(OBJ)
    return Capture(tmp_path, (), world_from_source=WORLD_FROM_Z_UP.copy())


def load(capture: Capture, path: str | Path = "mesh.obj", **options: object) -> Mesh:
    _, scene = MeshFile(MeshFileOptions(path=str(path), **options)).initialize(capture, None, capture.path)  # type: ignore[arg-type]
    assert scene is not None
    return scene.mesh


def test_axes_of_the_capture_and_welded_seams(capture: Capture) -> None:
    mesh = load(capture)
    corners = {tuple(np.round(p, 6).tolist()) for p in mesh.positions.numpy()}
    # (x, y, z) -> (x, z, -y)
    assert corners == {(0, 0, 0), (1, 0, 0), (0, 0, -1), (0, 2, 0)}
    assert mesh.topology.edges.shape[0] == 6 and len(mesh.faces) == 4
    volume = trimesh.Trimesh(mesh.positions.numpy(), mesh.faces.numpy(), process=False).volume
    np.testing.assert_allclose(volume, 1 / 3, rtol=1e-6)


def test_texture_coordinates_have_their_origin_top_left(capture: Capture) -> None:
    mesh = load(capture)
    assert mesh.uvs is not None and mesh.topology.uv_faces is not None
    found = {}
    for face, uv_face in zip(mesh.faces.numpy(), mesh.topology.uv_faces.numpy(), strict=True):
        for vertex, uv in zip(face, uv_face, strict=True):
            found.setdefault(tuple(np.round(mesh.positions[vertex].numpy(), 6).tolist()), set()).add(
                tuple(np.round(mesh.uvs[uv].numpy(), 6).tolist())
            )
    assert found[(0, 0, -1)] == {(0.25, 0.25)}
    assert found[(0, 0, 0)] == {(0, 1), (0.5, 0.5)}


def test_gltf_is_y_up(capture: Capture) -> None:
    box = trimesh.creation.box((1, 2, 3))
    box.export(capture.path / "box.glb")
    for axes, size in (("auto", [1, 2, 3]), ("source", [1, 3, 2])):
        positions = load(capture, "box.glb", axes=axes).positions.numpy()
        np.testing.assert_allclose(np.ptp(positions, axis=0), size, rtol=1e-6)


def test_a_transform_comes_first(capture: Capture) -> None:
    scale = (2.0, 0, 0, 5, 0, 2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 1)
    np.testing.assert_allclose(load(capture, transform=scale).positions.numpy().max(axis=0), [7, 4, 0], atol=1e-6)
    mirror = (-1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1)
    mesh = load(capture, transform=mirror)
    assert trimesh.Trimesh(mesh.positions.numpy(), mesh.faces.numpy(), process=False).volume > 0
    for wrong in ((1.0,), (1.0, 0, 0, 0, 0, 2, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1), (0.0,) * 16):
        with pytest.raises(ConfigError, match="transform"):
            load(capture, transform=wrong)


def test_vertex_colours_are_linear(capture: Capture) -> None:
    box = trimesh.creation.box()
    box.visual.vertex_colors = np.tile([188, 0, 255, 255], (8, 1))
    box.export(capture.path / "box.ply")
    colors = load(capture, "box.ply").vertex_colors
    assert colors is not None
    np.testing.assert_allclose(colors.numpy(), np.tile([0.5029, 0, 1], (8, 1)), atol=1e-3)


PALETTE = np.random.default_rng(5).integers(0, 256, (8, 8, 3)).astype(np.uint8)
TWO_MATERIALS = OBJ.replace("f 1/1 2/2 4/4", "usemtl b\nf 1/1 2/2 4/4").replace("f 1/1 3/3", "usemtl a\nf 1/1 3/3", 1)


def scanned(capture: Capture, obj: str, library: str | None) -> tuple[Scene, Scan]:
    """What is read from an .obj with a material library, or without the library that it names."""
    folder = capture.path / ("with" if library else "without")
    folder.mkdir(exist_ok=True)
    (folder / "scan.obj").write_text("mtllib scan.mtl\n" + obj)
    write_png(folder / "a.png", PALETTE)
    write_png(folder / "b.png", 255 - PALETTE)
    if library:
        (folder / "scan.mtl").write_text(library)
    initializer = MeshFile(MeshFileOptions(path=str(folder / "scan.obj"), vertex_colors=False))
    _, scene = initializer.initialize(capture, None, capture.path)
    scan = initializer.scan()
    assert scene is not None and scan is not None
    return scene, scan


@pytest.mark.parametrize("materials", [1, 2])
def test_a_texture_is_no_part_of_the_scene(capture: Capture, materials: int) -> None:
    """Whatever follows gets the same bits with and without the picture: also where trimesh would pack several."""
    obj = "usemtl a\n" + OBJ if materials == 1 else TWO_MATERIALS
    library = "newmtl a\nmap_Kd a.png\nnewmtl b\nmap_Kd b.png\n"
    found = []
    with warnings.catch_warnings(record=True):
        warnings.simplefilter("always")
        for named in (library, None):
            scene, scan = scanned(capture, obj, named)
            save_stage_scene(scene, capture.path / "stored")
            found.append({file.name: file.read_bytes() for file in (capture.path / "stored").iterdir()})
            assert (scan.texture is not None) == (named is not None and materials == 1)
            assert scan.file == "scan.obj"
            if scan.texture is not None:
                np.testing.assert_array_equal(scan.texture, PALETTE)
    assert found[0] == found[1] and "arrays.npz" in found[0]


def test_several_materials_keep_their_coordinates(capture: Capture) -> None:
    """Each corner has the coordinates of the file; a warning says why no texture is compared."""
    with pytest.warns(UserWarning, match=r"scan\.obj has 2 base colours .*bake them .*photographs at the vertices"):
        scene, _ = scanned(capture, TWO_MATERIALS, "newmtl a\nmap_Kd a.png\nnewmtl b\nmap_Kd b.png\n")
    mesh = scene.mesh
    assert mesh.uvs is not None and mesh.topology.uv_faces is not None
    corners = {tuple(uv) for uv in mesh.uvs[mesh.topology.uv_faces].reshape(-1, 2).tolist()}
    assert corners == {(0.0, 1.0), (1.0, 1.0), (0.25, 0.25), (0.5, 0.5)}


def test_a_texture_off_the_square_is_not_compared(capture: Capture) -> None:
    with pytest.warns(UserWarning, match=r"scan\.obj: its texture coordinates leave 0…1; pack them .*; until then"):
        _, scan = scanned(capture, "usemtl a\n" + OBJ.replace("vt 1 0", "vt 1.5 0"), "newmtl a\nmap_Kd a.png\n")
    assert scan.texture is None


def test_a_texture_that_is_missing_or_damaged_is_a_warning(capture: Capture) -> None:
    with pytest.warns(UserWarning, match=r"'gone\.png', which is not in its folder; .*at the vertices"):
        _, scan = scanned(capture, "usemtl a\n" + OBJ, "newmtl a\nmap_Kd gone.png\n")
    assert scan.texture is None
    initializer = MeshFile(MeshFileOptions(path=str(capture.path / "with" / "scan.obj")))
    assert [file.name for file in initializer.files(capture)] == ["scan.obj", "scan.mtl"]
    data = (capture.path / "with" / "a.png").read_bytes()
    (capture.path / "with" / "gone.png").write_bytes(data[: len(data) // 2])
    with pytest.warns(UserWarning, match=r"gone\.png is a broken image"):
        initializer.initialize(capture, None, capture.path)
    assert [file.name for file in initializer.files(capture)] == ["scan.obj", "scan.mtl", "gone.png"]


@pytest.mark.filterwarnings("ignore:.*until then the report compares:UserWarning")
def test_files_that_are_no_meshes(capture: Capture, shared: Path) -> None:
    with pytest.raises(ConfigError, match="path=FILE"):
        load(capture, "")
    with pytest.raises(ConfigError, match="nowhere"):
        load(capture, "nowhere.ply")
    with pytest.raises(ConfigError, match=r"~nobody-of-this-name/scan\.obj is neither"):
        load(capture, "~nobody-of-this-name/scan.obj")
    hostile = sorted(p for p in (shared / "hostile" / "meshes").rglob("*") if p.is_file())
    assert hostile
    for path in hostile:
        try:
            mesh = load(capture, path)
        except CaptureError as error:
            assert path.name in str(error) and "\n" not in str(error)
        else:
            assert np.isfinite(mesh.positions.numpy()).all() and len(mesh.faces) > 0
            assert int(mesh.faces.min()) >= 0 and int(mesh.faces.max()) < len(mesh.positions)


def test_any_world_keeps_its_precision(capture: Capture) -> None:
    far = np.eye(4)
    far[:3, 3] = [1000.0, 0, 0]
    moved = load(replace(capture, world_from_source=far @ capture.world_from_source))
    assert moved.topology.edges.shape[0] == 6


def lopsided(count: int = 4000) -> tuple[np.ndarray, trimesh.Trimesh]:
    """Points on, and the mesh of, a thing without any symmetry: three boxes."""
    boxes = [
        trimesh.creation.box(extents, trimesh.transformations.translation_matrix(place))
        for extents, place in (
            ((2, 1, 0.5), (0, 0, 0)),
            ((0.4, 0.4, 1.2), (0.7, 0.2, 0.6)),
            ((0.3, 0.9, 0.3), (-0.8, 0.6, 0.1)),
        )
    ]
    mesh = trimesh.util.concatenate(boxes)
    return np.asarray(mesh.sample(count, seed=3)), mesh


def test_a_scan_of_unknown_place_is_brought_onto_the_points(tmp_path: Path) -> None:
    points, mesh = lopsided()
    turn = trimesh.transformations.euler_matrix(1.4, 0.3, -2.0)
    moved = turn.copy()
    moved[:3, :3] *= 0.02
    moved[:3, 3] = [5.0, -3.0, 8.0]
    mesh.copy().apply_transform(moved).export(tmp_path / "scan.ply")
    rng = np.random.default_rng(1)
    # a tenth of the points are the room's
    points = np.concatenate([points + rng.normal(scale=0.003, size=points.shape), rng.uniform(-2, 2, (400, 3))])
    capture = Capture(tmp_path, (), points=OrientedPoints(points))
    initializer = MeshFile(MeshFileOptions(path="scan.ply", align="points"))
    _, scene = initializer.initialize(capture, None, tmp_path)
    assert scene is not None
    found = scene.mesh.positions.numpy().astype(np.float64)
    distance = np.linalg.norm(found[:, None] - np.asarray(mesh.vertices)[None], axis=2).min(axis=1)
    # the thing is two units long
    assert distance.max() < 0.02
    assert initializer.report()["mean_distance"] < 0.01


def test_another_thing_is_not_aligned(tmp_path: Path) -> None:
    _, mesh = lopsided()
    mesh.export(tmp_path / "scan.ply")
    noise = np.random.default_rng(0).normal(size=(2000, 3))
    with pytest.raises(CaptureError, match="does not fit"):
        load(Capture(tmp_path, (), points=OrientedPoints(noise)), "scan.ply", align="points")
    with pytest.raises(CaptureError, match="at least 100"):
        load(Capture(tmp_path, ()), "scan.ply", align="points")
