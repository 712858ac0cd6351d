"""Collision shapes: convex, around the mesh, named for their engines, and skipped by readers of meshes."""

import dataclasses
import importlib.util
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hir_exporters.asset import Asset, AssetMesh
from hir_exporters.errors import ExportError
from hir_exporters.format_options import GltfConfig, UsdConfig, UsdzConfig
from hir_exporters.formats import create_exporter
from hir_exporters.mesh import convex_decomposition
from hir_exporters.mesh.convex_decomposition import ConvexHull, convex_hulls
from hir_exporters.reading.file_verification import verify_file
from hir_exporters.reading.mesh_import import load_mesh_asset
from pxr import Usd, UsdGeom, UsdPhysics


def two_boxes() -> AssetMesh:
    """An L of two boxes side by side, which one convex hull would fill."""
    boxes = [trimesh.creation.box((0.2, 1, 0.2)), trimesh.creation.box((1, 0.2, 0.2))]
    boxes[1].apply_translation((0.6, -0.4, 0))
    positions = np.concatenate([box.vertices for box in boxes])
    faces = np.concatenate([boxes[0].faces, boxes[1].faces + len(boxes[0].vertices)])
    corners = positions[faces].reshape(-1, 3)
    normals = np.repeat(np.concatenate([box.face_normals for box in boxes]), 3, axis=0)
    uvs = np.tile([[0.1, 0.1], [0.9, 0.1], [0.1, 0.9]], (len(faces), 1))
    return AssetMesh(corners, normals, uvs, np.arange(len(corners)).reshape(-1, 3))


@pytest.fixture
def hulls(monkeypatch: pytest.MonkeyPatch) -> tuple[ConvexHull, ...]:
    """Two hulls in place of CoACD's, which takes seconds."""
    boxes = [trimesh.creation.box((0.4, 0.5, 0.6)), trimesh.creation.box((0.2, 0.2, 0.3))]
    found = tuple(ConvexHull(box.vertices.astype(np.float32), box.faces.astype(np.int32)) for box in boxes)
    for module in ("gltf.gltf_exporter", "usd.usd_exporter"):
        monkeypatch.setattr(f"hir_exporters.{module}.convex_hulls", lambda mesh, count: found[:count])
    return found


@pytest.mark.skipif(importlib.util.find_spec("coacd") is None, reason="hir[collision] is not installed")
def test_two_boxes_are_two_hulls_around_them() -> None:
    mesh = two_boxes()
    found = convex_hulls(mesh, 4)
    assert 2 <= len(found) <= 4
    solids = [trimesh.Trimesh(hull.positions, hull.faces, process=False) for hull in found]
    for solid in solids:
        assert solid.is_watertight and solid.is_convex and solid.volume > 0
    assert sum(solid.volume for solid in solids) < 0.1, "a single hull has more than 0.2; the boxes have 0.08"
    outside = np.stack(
        [((mesh.positions[:, None] - s.triangles_center) * s.face_normals).sum(-1).max(axis=1) for s in solids]
    )
    assert outside.min(axis=0).max() < 0.03, "every corner is in or near a hull"


@pytest.mark.parametrize(
    ("target", "names"), [("unreal", ["UCX_sphere_00", "UCX_sphere_01"]), ("godot", ["sphere_00-convcolonly"] * 1)]
)
@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_gltf_hulls_have_the_names_of_the_engine(
    textured_asset: Asset, hulls: tuple[ConvexHull, ...], tmp_path: Path, target: str, names: list[str], suffix: str
) -> None:
    config = GltfConfig(collision=target, collision_hulls=len(names))  # type: ignore[arg-type]
    path = tmp_path / f"x.{suffix}"
    create_exporter(suffix, config).write(textured_asset, path)
    scene = trimesh.load_scene(path)
    assert sorted(set(scene.graph.nodes_geometry) - {"sphere"}) == names
    for name, hull in zip(names, hulls, strict=False):
        matrix, geometry = scene.graph[name]
        np.testing.assert_array_equal(matrix, np.eye(4))
        shape = scene.geometry[geometry]
        assert shape.is_convex and shape.volume == pytest.approx(trimesh.Trimesh(hull.positions, hull.faces).volume)


def test_readers_of_meshes_skip_the_hulls(textured_asset: Asset, hulls: tuple[ConvexHull, ...], tmp_path: Path) -> None:
    for suffix, config in (
        ("glb", GltfConfig(collision="unreal")),
        ("gltf", GltfConfig(collision="godot", quantize=True)),
        ("usda", UsdConfig(collision=True)),
        ("usdz", UsdzConfig(collision=True)),
    ):
        path = tmp_path / f"{suffix}.{suffix}"
        create_exporter(suffix, config).write(textured_asset, path)  # type: ignore[arg-type]
        assert verify_file(path, textured_asset).problems == (), suffix
    assert len(load_mesh_asset(tmp_path / "glb.glb").mesh.faces) == len(textured_asset.mesh.faces)


def test_usd_hulls_are_collision_shapes_that_are_not_rendered(
    textured_asset: Asset, hulls: tuple[ConvexHull, ...], tmp_path: Path
) -> None:
    create_exporter("usdc", UsdConfig(collision=True)).write(textured_asset, tmp_path / "x.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "x.usdc"))
    shapes = [prim for prim in stage.Traverse() if prim.HasAPI(UsdPhysics.CollisionAPI)]
    assert [prim.GetName() for prim in shapes] == ["Hull_00", "Hull_01"]
    for prim, hull in zip(shapes, hulls, strict=True):
        assert UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get() == "convexHull"
        assert UsdGeom.Imageable(prim).ComputePurpose() == UsdGeom.Tokens.guide
        np.testing.assert_array_equal(UsdGeom.Mesh(prim).GetPointsAttr().Get(), hull.positions)


def test_a_missing_library_names_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(convex_decomposition, "find_spec", lambda name: None)
    with pytest.raises(ExportError, match=r"coacd.*hir\[collision\]"):
        convex_hulls(two_boxes(), 4)


@pytest.mark.skipif(importlib.util.find_spec("coacd") is None, reason="hir[collision] is not installed")
def test_what_has_no_volume_has_a_thin_hull() -> None:
    mesh = two_boxes()
    triangle = dataclasses.replace(
        mesh, positions=mesh.positions[:3], normals=mesh.normals[:3], uvs=mesh.uvs[:3], faces=mesh.faces[:1]
    )
    (hull,) = convex_hulls(triangle, 2)
    low, high = hull.positions.min(axis=0), hull.positions.max(axis=0)
    assert (low <= triangle.positions.min(axis=0)).all() and (high >= triangle.positions.max(axis=0)).all()
    assert (high - low).min() < 0.02


@pytest.mark.parametrize("make", [lambda: GltfConfig(collision_hulls=4), lambda: UsdConfig(collision_hulls=4)])
def test_a_number_of_hulls_without_hulls_is_refused(make: object) -> None:
    with pytest.raises(ValueError, match="no collision shapes are written"):
        make()  # type: ignore[operator]
