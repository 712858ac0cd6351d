import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.asset import AssetMesh
from hir_exporters.mesh.tangents import corner_tangents, with_tangents

Sphere = Callable[..., AssetMesh]


def reference(mesh: AssetMesh, tools: Path, folder: Path) -> np.ndarray:
    """Corner tangents (F, 3, 4) of mikktspace.c itself, its sign turned to glTF's upper left UV origin."""
    corners = np.concatenate([mesh.positions, mesh.normals, mesh.uvs], axis=1)[mesh.faces.reshape(-1)]
    (folder / "in").write_bytes(corners.astype("<f4").tobytes())
    subprocess.run(["node", str(tools / "mikktspace.cjs"), str(folder / "in"), str(folder / "out")], check=True)
    tangents = np.frombuffer((folder / "out").read_bytes(), "<f4").reshape(-1, 3, 4)
    return tangents * np.float32([1, 1, 1, -1])


def mirrored(mesh: AssetMesh) -> AssetMesh:
    """The right half of the texture folded onto the left: both handednesses meet at a seam of equal UVs."""
    uvs = mesh.uvs.copy()
    uvs[:, 0] = np.abs(uvs[:, 0] - 0.5) * 2
    return replace(mesh, uvs=uvs)


def shredded(mesh: AssetMesh) -> AssetMesh:
    """Extra faces on one edge, a triangle without area, one without texture, one seen twice and one turned over."""
    uvs, faces = mesh.uvs.copy(), mesh.faces.copy()
    uvs[faces[40]] = uvs[faces[40][0]]
    extra = [
        faces[10][::-1],
        faces[20],
        [faces[30][0], faces[30][1], faces[200][2]],
        [faces[50][0]] * 2 + [faces[50][1]],
    ]
    return replace(mesh, uvs=uvs, faces=np.concatenate([faces, np.int32(extra)]))


@pytest.mark.parametrize("change", [lambda m: m, mirrored, shredded])
def test_tangents_are_those_of_the_reference(
    change: Sphere, make_sphere: Sphere, node_tools: Path, tmp_path: Path
) -> None:
    mesh = change(make_sphere(20, 40, wobble=0.3))
    ours = corner_tangents(mesh.positions, mesh.normals, mesh.uvs, mesh.faces)
    theirs = reference(mesh, node_tools, tmp_path)
    same = (np.abs(ours - theirs) < 2e-4).all(-1)
    assert same.mean() == 1.0, np.flatnonzero(~same.all(1))


@pytest.mark.parametrize("name", ["suzanne", "avocado"])
def test_tangents_of_real_meshes_are_those_of_the_reference(
    name: str, shared: Path, node_tools: Path, tmp_path: Path
) -> None:
    import trimesh

    [path] = (shared / "models" / name).glob("glTF/*.gltf")
    loaded = trimesh.load(path, force="mesh", process=False)
    uvs = loaded.visual.uv * [1, -1] + [0, 1]  # trimesh turns v upwards
    mesh = AssetMesh(loaded.vertices, loaded.vertex_normals, uvs, loaded.faces)
    ours = corner_tangents(mesh.positions, mesh.normals, mesh.uvs, mesh.faces)
    theirs = reference(mesh, node_tools, tmp_path)
    angle = np.degrees(np.arccos(np.clip((ours[..., :3] * theirs[..., :3]).sum(-1), -1, 1)))
    assert (ours[..., 3] == theirs[..., 3]).mean() > 0.9999
    assert np.quantile(angle, 0.999) < 0.1


def test_mirrored_seams_split_vertices_and_nothing_else_does(make_sphere: Sphere) -> None:
    plain = make_sphere(10, 20)
    assert len(with_tangents(plain).positions) == len(plain.positions)
    folded = mirrored(plain)
    split = with_tangents(folded)
    assert len(split.positions) > len(folded.positions)
    for name in ("positions", "normals", "uvs"):
        np.testing.assert_array_equal(getattr(split, name)[split.faces], getattr(folded, name)[folded.faces])
    expected = corner_tangents(folded.positions, folded.normals, folded.uvs, folded.faces)
    np.testing.assert_array_equal(split.tangents[split.faces], expected)
    assert with_tangents(split) is split


def test_bitangent_points_up_the_texture(make_sphere: Sphere) -> None:
    mesh = make_sphere(16, 32)
    tangents = corner_tangents(mesh.positions, mesh.normals, mesh.uvs, mesh.faces)[100]
    corner = mesh.faces[100]
    bitangents = np.cross(mesh.normals[corner], tangents[:, :3]) * tangents[:, 3:]
    azimuth = np.cross([0, 1, 0], mesh.normals[corner])
    assert (np.sum(tangents[:, :3] * azimuth, -1) > 0.99 * np.linalg.norm(azimuth, axis=-1)).all()
    assert (bitangents[:, 1] > 0).all()  # v grows downwards on this sphere


def test_meshes_without_texture_or_area_get_unit_tangents(make_sphere: Sphere) -> None:
    mesh = make_sphere(4, 8)
    for broken in (replace(mesh, uvs=mesh.uvs * 0), replace(mesh, positions=mesh.positions * 0)):
        tangents = with_tangents(broken).tangents
        np.testing.assert_allclose(np.linalg.norm(tangents[:, :3], axis=1), 1, atol=1e-6)
        assert (np.abs(tangents[:, 3]) == 1).all()


def test_a_hundred_thousand_triangles_take_no_time(make_sphere: Sphere) -> None:
    import time

    mesh = make_sphere(200, 260)
    start = time.process_time()
    with_tangents(mesh)
    assert len(mesh.faces) > 100_000 and time.process_time() - start < 5
