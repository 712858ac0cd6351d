from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hir_exporters.asset import Asset, AssetMaterial, AssetMesh
from hir_exporters.format_options import GltfConfig
from hir_exporters.formats import create_exporter
from hir_exporters.mesh.simplification import simplify
from hir_exporters.mesh.tangents import with_tangents
from hir_exporters.mesh.vertex_welding import weld
from hir_exporters.reading.gltf_readback import read_gltf
from hir_exporters.textures.uv_rasterization import rasterize_uvs

Sphere = Callable[..., AssetMesh]


def welded(mesh: AssetMesh) -> trimesh.Trimesh:
    first, group = weld(mesh.positions)
    return trimesh.Trimesh(mesh.positions[first], group[mesh.faces], process=False)


def uv_areas(mesh: AssetMesh) -> np.ndarray:
    a, b, c = mesh.uvs.astype(np.float64)[mesh.faces].transpose(1, 0, 2)
    return (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]


def closed(mesh: AssetMesh) -> AssetMesh:
    """The poles of the UV sphere are points up to rounding; here they are exactly."""
    positions = mesh.positions.copy()
    positions[np.abs(positions) < 1e-6] = 0
    return replace(mesh, positions=positions)


@pytest.mark.parametrize("triangles", [2000, 600, 150])
def test_a_closed_mesh_stays_closed_and_its_texture_unfolded(triangles: int, make_sphere: Sphere) -> None:
    mesh = closed(make_sphere(40, 80, wobble=0.2))
    assert welded(mesh).is_watertight
    coarse = simplify(mesh, triangles)
    result = welded(coarse)
    assert triangles - 2 <= len(coarse.faces) <= triangles
    assert result.is_watertight and result.is_winding_consistent and result.euler_number == 2
    assert (uv_areas(coarse) * np.sign(uv_areas(mesh).sum()) >= 0).all()
    # The sides of the seam move together: the texture is covered as before, but for straightened poles.
    assert abs(uv_areas(coarse).sum()) > 0.9 * abs(uv_areas(mesh).sum())


def test_it_is_the_same_surface_within_the_size_of_its_triangles(make_sphere: Sphere) -> None:
    mesh = make_sphere(60, 120)
    for triangles in (4000, 1000, 250):
        coarse = simplify(mesh, triangles)
        middles = coarse.positions[coarse.faces].mean(axis=1)
        # The middle of an equilateral triangle of that area lies below the unit sphere by a sixth of its edge squared.
        sag = 4 * (4 * np.pi / triangles) / np.sqrt(3) / 6
        depth = 1 - np.linalg.norm(middles, axis=1)
        assert depth.min() > -1e-6 and depth.mean() < 2 * sag and depth.max() < 12 * sag


def test_flat_regions_go_first_and_corners_stay() -> None:
    side = np.linspace(0, 1, 21)
    x, y = (v.ravel() for v in np.meshgrid(side, side, indexing="ij"))
    corner = np.arange(441).reshape(21, 21)
    a, b, c, d = (v.ravel() for v in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    plate = AssetMesh(np.stack([x, y, 0 * x], 1), [[0, 0, 1]] * 441, np.stack([x, 1 - y], 1), faces)
    coarse = simplify(plate, 8)
    assert len(coarse.faces) <= 8
    assert welded(coarse).area == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(coarse.uvs, np.stack([coarse.positions[:, 0], 1 - coarse.positions[:, 1]], 1), atol=1e-6)


def test_vertices_that_remain_are_vertices_that_were(make_sphere: Sphere) -> None:
    mesh = make_sphere(30, 60)
    coarse = simplify(mesh, 500)
    before = {row.tobytes() for row in np.concatenate([mesh.positions, mesh.normals, mesh.uvs], axis=1)}
    assert {row.tobytes() for row in np.concatenate([coarse.positions, coarse.normals, coarse.uvs], axis=1)} <= before


def test_the_same_again_and_nothing_to_do(make_sphere: Sphere) -> None:
    mesh = make_sphere(20, 40)
    np.testing.assert_array_equal(simplify(mesh, 300).faces, simplify(mesh, 300).faces)
    assert simplify(mesh, 10**6) is mesh


@pytest.mark.parametrize(
    "name", ["reference.obj", "fuze.obj", "not_convex.obj", "joined_tetrahedra.obj", "wallhole.obj"]
)
def test_meshes_of_others_never_break_it(name: str, shared: Path) -> None:
    loaded = trimesh.load(shared / "hostile" / "meshes" / name, force="mesh", process=False)
    count = len(loaded.vertices)
    uvs = getattr(loaded.visual, "uv", None)
    mesh = AssetMesh(
        loaded.vertices, np.tile([0, 0, 1], (count, 1)), np.zeros((count, 2)) if uvs is None else uvs, loaded.faces
    )
    coarse = simplify(mesh, max(1, len(mesh.faces) // 4))
    assert 0 < len(coarse.faces) <= len(mesh.faces) and coarse.faces.max() < len(coarse.positions)
    assert np.isfinite(coarse.positions).all()


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_levels_of_detail_are_files_of_their_own(textured_asset: Asset, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"x.{suffix}"
    report = create_exporter(suffix, GltfConfig(lods=(200, 80))).write(textured_asset, path)
    counts = [len(read_gltf(tmp_path / f"x{level}.{suffix}").corner_positions) for level in ("", "_lod1", "_lod2")]
    assert counts[0] == len(textured_asset.mesh.faces) and 190 <= counts[1] <= 200 and 70 <= counts[2] <= 80
    assert report.files[0] == path and all(file.is_file() for file in report.files)


def shading(mesh: AssetMesh, normal: np.ndarray | None, size: int, texels: np.ndarray) -> np.ndarray:
    """Unit normals (N, 3) that a shader sees at texels, from the mesh and its map."""
    cover = rasterize_uvs(mesh.uvs, mesh.faces, size)
    n, t = cover.interpolated(mesh.normals, mesh.faces), np.zeros((len(cover.texels), 4))
    seen = n
    if normal is not None:
        t = cover.interpolated(mesh.tangents, mesh.faces)
        b = np.cross(n, t[:, :3]) * np.sign(t[:, 3:])
        x, y, z = normal.reshape(-1, 3)[cover.texels].T[..., None]
        seen = x * t[:, :3] + y * b + z * n
    result = np.zeros((size * size, 3))
    result[cover.texels] = seen / np.linalg.norm(seen, axis=-1, keepdims=True)
    return result[texels]


@pytest.mark.parametrize("mapped", [False, True])
def test_a_level_of_detail_shades_as_the_finest(
    mapped: bool, textured_asset: Asset, make_sphere: Sphere, tmp_path: Path
) -> None:
    """Read back from the file: within 8 bits of the fine mesh's normals, which the coarse mesh alone is far from.

    Measured without a map of the finest's own: mean 0.17 degrees, hundredth worst 0.29; 4.8 degrees without the map.
    """
    fine = make_sphere(60, 120, wobble=0.15)
    vectors = trimesh.Trimesh(*(lambda f, g: (fine.positions[f], g[fine.faces]))(*weld(fine.positions)), process=False)
    fine = replace(fine, normals=vectors.vertex_normals[weld(fine.positions)[1]])
    normal = textured_asset.material.normal if mapped else None
    asset = replace(textured_asset, mesh=fine, material=replace(textured_asset.material, normal=normal))
    create_exporter("glb", GltfConfig(lods=(600,))).write(asset, tmp_path / "x.glb")
    back = read_gltf(tmp_path / "x_lod1.glb")
    assert back.normal is not None
    size, count = back.normal.shape[0], len(back.corner_positions)
    assert size == 32 and 500 < count <= 600
    coarse = with_tangents(
        AssetMesh(
            back.corner_positions.reshape(-1, 3),
            back.corner_normals.reshape(-1, 3),
            back.corner_uvs.reshape(-1, 2),
            np.arange(3 * count).reshape(-1, 3),
        )
    )
    inner = np.intersect1d(*(rasterize_uvs(m.uvs, m.faces, size).texels for m in (fine, coarse)))
    inner = inner[(inner // size > 1) & (inner // size < size - 2)]  # at the poles triangles have no texture
    want = shading(with_tangents(fine), normal, size, inner)
    with_map, without = (
        np.degrees(np.arccos(np.clip((shading(coarse, m, size, inner) * want).sum(-1), -1, 1)))
        for m in (back.normal, None)
    )
    assert with_map.mean() < 0.3 and np.quantile(with_map, 0.99) < 0.6 and without.mean() > 4


def test_overlapping_textures_keep_their_own_normals_and_say_so(make_sphere: Sphere, tmp_path: Path) -> None:
    mesh = make_sphere(20, 40)
    folded = replace(mesh, uvs=np.abs(mesh.uvs - [0.5, 0]) * [2, 1])
    asset = Asset(folded, AssetMaterial("dielectric", [0.5] * 3, [0.04] * 3, 0.3))
    report = create_exporter("glb", GltfConfig(lods=(300,))).write(asset, tmp_path / "x.glb")
    assert any("keeps its own normals" in warning for warning in report.warnings)
    assert read_gltf(tmp_path / "x_lod1.glb").normal is None


def test_a_level_that_is_no_coarser_is_said(make_sphere: Sphere, tmp_path: Path) -> None:
    mesh = make_sphere(5, 8)
    asset = Asset(mesh, AssetMaterial("dielectric", [0.5] * 3, [0.04] * 3, 0.3))
    report = create_exporter("glb", GltfConfig(lods=(10_000,))).write(asset, tmp_path / "x.glb")
    said = f"level of detail 1 is as fine as the one before, which has {len(mesh.faces)} triangles; ask for fewer"
    assert said in report.warnings


def test_every_texel_belongs_to_one_triangle(make_sphere: Sphere) -> None:
    mesh = make_sphere(7, 13)
    cover = rasterize_uvs(mesh.uvs, mesh.faces, 64)
    assert cover.overlap == 0 and (cover.weights >= -1e-9).all()
    texel_positions = cover.interpolated(mesh.uvs, mesh.faces) * 64 - 0.5
    np.testing.assert_allclose(texel_positions[:, 1] * 64 + texel_positions[:, 0], cover.texels, atol=1e-6)
    full = rasterize_uvs(np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]), np.array([[0, 1, 2], [0, 2, 3]]), 32)
    np.testing.assert_array_equal(full.texels, np.arange(1024))
