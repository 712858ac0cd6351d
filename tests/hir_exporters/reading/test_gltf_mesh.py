"""The reader of exported glTF meshes against trimesh, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hir_exporters.asset import Asset
from hir_exporters.errors import InputError
from hir_exporters.exporter import Edit
from hir_exporters.formats import create_exporter
from hir_exporters.reading.gltf_readback import read_gltf
from pygltflib import GLTF2, Node


def under_parents(document: GLTF2, asset: Asset) -> None:
    """Puts the mesh under a node with a matrix and one with translation, rotation and scale."""
    document.nodes[0].translation, document.nodes[0].scale = [0.1, -0.2, 0.3], [0.5, 0.5, 0.5]
    document.nodes[0].rotation = [0.1825742, 0.3651484, 0.5477226, 0.7302967]
    turned = [0, 0, -2, 0, 0, 2, 0, 0, 2, 0, 0, 0, 1, 2, 3, 1]  # by columns: a quarter turn about +Y, twice as large
    document.nodes.append(Node(children=[0], matrix=turned))
    document.scenes[0].nodes = [len(document.nodes) - 1]


@pytest.mark.parametrize("edit", [None, under_parents])
def test_corners_are_those_that_trimesh_reads(edit: Edit | None, textured_asset: Asset, tmp_path: Path) -> None:
    path = tmp_path / "x.glb"
    create_exporter("glb").write(textured_asset, path, edit)
    back = read_gltf(path)
    scene = trimesh.load_scene(path, process=False)
    to_world, name = scene.graph[scene.graph.nodes_geometry[0]]
    mesh = scene.geometry[name]
    positions = trimesh.transform_points(mesh.vertices, to_world)[mesh.faces]
    np.testing.assert_allclose(back.corner_positions, positions, atol=1e-6)
    np.testing.assert_allclose(back.corner_uvs, (np.asarray(mesh.visual.uv) * [1, -1] + [0, 1])[mesh.faces], atol=1e-6)
    normals = mesh.vertex_normals @ np.linalg.inv(to_world[:3, :3])
    assert (np.linalg.norm(normals, axis=1) > 0).all()
    np.testing.assert_allclose(back.corner_normals, normals[mesh.faces], atol=1e-5)


def a_cycle(document: GLTF2, asset: Asset) -> None:
    document.nodes[0].children = [0]


def no_normals(document: GLTF2, asset: Asset) -> None:
    document.meshes[0].primitives[0].attributes.NORMAL = None


def lines(document: GLTF2, asset: Asset) -> None:
    document.meshes[0].primitives[0].mode = 1


def a_short_buffer(document: GLTF2, asset: Asset) -> None:
    document.accessors[document.meshes[0].primitives[0].attributes.POSITION].count = 10**6


def far_indices(document: GLTF2, asset: Asset) -> None:
    document.accessors[document.meshes[0].primitives[0].attributes.POSITION].count = 3


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (a_cycle, "occurs twice"),
        (no_normals, "without normals"),
        (lines, "not one list of triangles"),
        (a_short_buffer, "cannot be read"),
        (far_indices, "cannot be read"),
    ],
)
def test_damaged_documents_are_one_sentence(edit: Edit, message: str, textured_asset: Asset, tmp_path: Path) -> None:
    create_exporter("glb").write(textured_asset, tmp_path / "x.glb", edit)
    with pytest.raises(InputError, match=message) as raised:
        read_gltf(tmp_path / "x.glb")
    assert "\n" not in str(raised.value)
