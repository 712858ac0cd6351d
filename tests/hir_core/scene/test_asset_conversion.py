"""A scene becomes an asset and comes back."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hir_exporters.scene_format import load_scene, save_scene

from hir_core.errors import StageError
from hir_core.scene import EnvironmentMap, Material, Scene
from hir_core.scene.asset_conversion import bake, scene_from_asset
from hir_core.stages.atlas import unwrap_mesh
from tests.fixtures.scenes import bumpy_sphere


def textured_scene() -> Scene:
    torch.manual_seed(0)
    mesh, _ = unwrap_mesh(bumpy_sphere(2), 64)
    normal = torch.nn.functional.normalize(torch.randn(8, 8, 3) * 0.1 + torch.tensor([0.0, 0.0, 1.0]), dim=-1)
    material = Material(
        "dielectric",
        torch.rand(16, 16, 3),
        torch.full((3,), 0.04),
        torch.rand(8, 8, 1),
        normal,
        torch.rand(16, 16) > 0.5,
    )
    turn = torch.tensor([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    return Scene(mesh, material, EnvironmentMap(torch.rand(4, 8, 3), turn, "camera"))


def test_faces_keep_their_corners() -> None:
    scene = textured_scene()
    asset = bake(scene, name="ball")
    mesh = scene.mesh
    assert mesh.uvs is not None and mesh.topology.uv_faces is not None
    np.testing.assert_array_equal(asset.mesh.positions[asset.mesh.faces], mesh.positions[mesh.faces].numpy())
    np.testing.assert_array_equal(asset.mesh.uvs[asset.mesh.faces], mesh.uvs[mesh.topology.uv_faces].numpy())
    pairs = np.concatenate([asset.mesh.positions, asset.mesh.uvs], axis=1)
    assert asset.mesh.tangents is not None
    pairs = np.concatenate([pairs, asset.mesh.tangents], axis=1)
    assert len(np.unique(pairs, axis=0)) == len(pairs)


def test_normals_do_not_break_at_seams() -> None:
    asset = bake(textured_scene())
    order = np.lexsort(asset.mesh.positions.T)
    positions, normals = asset.mesh.positions[order], asset.mesh.normals[order]
    same = (positions[1:] == positions[:-1]).all(axis=1)
    assert same.any()
    np.testing.assert_array_equal(normals[1:][same], normals[:-1][same])


def test_there_and_back_and_there_is_the_same_asset() -> None:
    asset = bake(textured_scene())
    again = bake(scene_from_asset(asset))
    for part in ("mesh", "material", "environment"):
        for name in getattr(asset, part).__dataclass_fields__:
            before, after = getattr(getattr(asset, part), name), getattr(getattr(again, part), name)
            if name == "normals":
                np.testing.assert_allclose(after, before, atol=1e-6)
            else:
                np.testing.assert_array_equal(after, before)


def test_scene_has_one_vertex_for_each_position() -> None:
    scene = textured_scene()
    back = scene_from_asset(bake(scene))
    assert len(back.mesh.positions) == len(scene.mesh.positions)
    assert back.material is not None and back.environment is not None
    assert back.material.roughness.shape == (8, 8, 1)
    assert back.environment.frame == "camera"
    torch.testing.assert_close(back.mesh.face_areas_normals, scene.mesh.face_areas_normals, rtol=0, atol=0)


def test_asset_survives_its_file(tmp_path) -> None:  # type: ignore[no-untyped-def]
    asset = bake(textured_scene())
    save_scene(asset, tmp_path / "scene")
    loaded = load_scene(tmp_path / "scene")
    np.testing.assert_array_equal(loaded.material.diffuse_albedo, asset.material.diffuse_albedo)
    np.testing.assert_array_equal(loaded.mesh.faces, asset.mesh.faces)


def test_constants_need_no_texture_coordinates() -> None:
    asset = bake(Scene(bumpy_sphere(1), Material("paper", torch.full((3,), 0.5), torch.zeros(3), torch.ones(1))))
    assert asset.material.roughness.shape == ()
    assert asset.mesh.uvs.shape == (len(asset.mesh.positions), 2)


def test_out_of_range_is_held_and_missing_is_named() -> None:
    bright = Material("paper", torch.full((3,), 1.5), torch.full((3,), -0.1), torch.zeros(1))
    asset = bake(Scene(bumpy_sphere(1), bright))
    assert asset.material.diffuse_albedo.max() == 1
    assert asset.material.specular_albedo.min() == 0
    assert asset.material.roughness > 0
    with pytest.raises(StageError, match="no material"):
        bake(Scene(bumpy_sphere(1)))
    with pytest.raises(StageError, match="no texture coordinates"):
        bake(Scene(bumpy_sphere(1), Material("paper", torch.rand(4, 4, 3), torch.zeros(3), torch.ones(1))))
