"""Assets from a mesh and textures that no run of ours made."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.asset import Asset, describe
from hir_exporters.conventions import linear_to_srgb, srgb_to_linear
from hir_exporters.errors import InputError
from hir_exporters.format_options import GltfConfig
from hir_exporters.formats import create_exporter
from hir_exporters.mesh.ply_format import encode_ply
from hir_exporters.reading.file_verification import verify_file
from hir_exporters.reading.gltf_json.stored_accessors import check_geometry
from hir_exporters.reading.gltf_readback import read_gltf
from hir_exporters.reading.material_overrides import MaterialOverrides, parse_material_override
from hir_exporters.reading.mesh_import import load_mesh_asset
from hir_exporters.textures.image_files import write_png
from pygltflib import GLTF2

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def corners(asset: Asset) -> np.ndarray:
    mesh = asset.mesh
    return np.concatenate([mesh.positions[mesh.faces], mesh.uvs[mesh.faces]], axis=-1)


@pytest.mark.parametrize("suffix", ["obj", "glb", "gltf", "usda", "usdz"])
def test_an_exported_core_material_comes_back(textured_asset: Asset, suffix: str, tmp_path: Path) -> None:
    """Core metallic-roughness is what all of them share: within the 8 bits of their textures."""
    core = dataclasses.replace(textured_asset.material, specular_albedo=np.full(3, 0.04, np.float32))
    asset = dataclasses.replace(textured_asset, material=core)
    create_exporter(suffix).write(asset, tmp_path / f"x.{suffix}")
    back = load_mesh_asset(tmp_path / f"x.{suffix}")
    order = [np.lexsort(corners(a).reshape(len(a.mesh.faces), -1).round(5).T) for a in (asset, back)]
    np.testing.assert_allclose(corners(asset)[order[0]], corners(back)[order[1]], atol=1e-5)
    shown, meant = linear_to_srgb(back.material.diffuse_albedo), linear_to_srgb(core.diffuse_albedo)
    np.testing.assert_allclose(shown, meant, atol=1.5 / 255)
    np.testing.assert_allclose(np.sqrt(back.material.roughness), np.sqrt(core.roughness), atol=1 / 255)
    np.testing.assert_allclose(back.material.specular_albedo, 0.04, atol=1e-5)
    assert back.material.normal is not None
    assert back.provenance == {"made_from": f"x.{suffix}"}


@pytest.mark.parametrize("suffix", ["obj", "ply", "glb", "gltf", "usda"])
def test_normals_are_those_of_the_file(constant_asset: Asset, suffix: str, tmp_path: Path) -> None:
    """Others than those of a smooth surface."""
    normals = constant_asset.mesh.normals + np.array([0.5, 0, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    asset = dataclasses.replace(constant_asset, mesh=dataclasses.replace(constant_asset.mesh, normals=normals))
    if suffix == "ply":
        (tmp_path / "x.ply").write_bytes(encode_ply(asset.mesh))
    else:
        create_exporter(suffix).write(asset, tmp_path / f"x.{suffix}")
    back = load_mesh_asset(tmp_path / f"x.{suffix}")
    order = [np.lexsort(corners(a).reshape(len(a.mesh.faces), -1).round(5).T) for a in (asset, back)]
    actual, expected = (a.mesh.normals[a.mesh.faces][o] for a, o in zip((back, asset), order[::-1], strict=True))
    np.testing.assert_allclose(actual, expected, atol=1e-5)


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_a_gltf_without_a_material_keeps_its_texture_coordinates(
    constant_asset: Asset, suffix: str, tmp_path: Path
) -> None:
    """As sculpting programs write it; trimesh alone reads TEXCOORD_0 only beside a material."""
    file = tmp_path / f"x.{suffix}"
    create_exporter(suffix).write(constant_asset, file)
    document = GLTF2().load(str(file))
    document.materials = []
    for primitive in document.meshes[0].primitives:
        primitive.material = None
    document.save(str(file))
    back, mesh = load_mesh_asset(file), constant_asset.mesh
    np.testing.assert_allclose(back.mesh.positions[back.mesh.faces], mesh.positions[mesh.faces], atol=1e-5)
    np.testing.assert_allclose(back.mesh.uvs[back.mesh.faces], mesh.uvs[mesh.faces], atol=1e-5)
    np.testing.assert_allclose(back.material.diffuse_albedo, 0.5, atol=0.03)
    red = load_mesh_asset(file, MaterialOverrides(base_color=(0.8, 0.1, 0.1))).material.diffuse_albedo
    assert red[..., 0].min() > 4 * red[..., 1].max()


def test_a_quantized_mesh_has_its_size(constant_asset: Asset, tmp_path: Path) -> None:
    create_exporter("glb", GltfConfig(quantize=True)).write(constant_asset, tmp_path / "q.glb")
    read, mesh = load_mesh_asset(tmp_path / "q.glb").mesh, constant_asset.mesh
    np.testing.assert_allclose(read.positions[read.faces], mesh.positions[mesh.faces], atol=4e-5)
    np.testing.assert_allclose(read.uvs[read.faces], mesh.uvs[mesh.faces], atol=1e-5)


def test_maps_and_light_by_hand(textured_asset: Asset, tmp_path: Path) -> None:
    create_exporter("obj").write(textured_asset, tmp_path / "x.obj")
    create_exporter("hdr").write(textured_asset, tmp_path / "sky.hdr")
    write_png(tmp_path / "packed.png", np.tile(np.array([0.0, 0.6, 1.0]), (4, 4, 1)))
    write_png(tmp_path / "gold.png", linear_to_srgb(np.tile(np.array([0.9, 0.6, 0.2]), (4, 4, 1))))
    maps = MaterialOverrides(tmp_path / "gold.png", tmp_path / "packed.png", tmp_path / "packed.png")
    asset = load_mesh_asset(tmp_path / "x.obj", maps, tmp_path / "sky.hdr")
    np.testing.assert_allclose(asset.material.specular_albedo, [0.9, 0.6, 0.2], atol=0.004)
    assert float(asset.material.diffuse_albedo.max()) == 0, "a metal"
    np.testing.assert_allclose(asset.material.roughness, 0.36, atol=0.003)
    assert asset.environment is not None and describe(asset)["environment"]["size"] == "64 x 32"
    create_exporter("glb").write(asset, tmp_path / "out" / "x.glb")
    assert verify_file(tmp_path / "out" / "x.glb", asset).problems == ()
    plain = load_mesh_asset(
        tmp_path / "x.obj", MaterialOverrides(base_color=(0.2, 0.3, 0.4), roughness=0.5, metallic=0.0)
    )
    np.testing.assert_allclose(plain.material.diffuse_albedo, [0.2, 0.3, 0.4], rtol=1e-6)


def test_bad_input_names_file_and_field(tmp_path: Path) -> None:
    (tmp_path / "bare.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "empty.obj").write_text("v 0 0 0\n")
    (tmp_path / "nan.obj").write_text("v nan 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n")
    (tmp_path / "far.obj").write_text("mtllib ../../secret.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n")
    (tmp_path / "beyond.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 9/3\n")
    (tmp_path / "broken.glb").write_bytes(b"glTF\0\0\0\0")
    (tmp_path / "mesh.txt").write_text("")
    for name, message in {
        "bare.obj": "bare.obj.*mesh.uvs",
        "empty.obj": "empty.obj",
        "nan.obj": "nan.obj.*mesh.positions",
        "far.obj": "outside",
        "beyond.obj": "beyond.obj.*mesh.faces.*index out of range",
        "broken.glb": "broken.glb",
        "mesh.txt": "known are",
        "none.glb": "does not exist",
    }.items():
        with pytest.raises(InputError, match=message):
            load_mesh_asset(tmp_path / name)
    with pytest.raises(InputError, match=r"lost.png for base color.*R,G,B"):
        parse_material_override("base_color", "lost.png")
    with pytest.raises(InputError, match="normal"):
        parse_material_override("normal", "0.5")


@pytest.mark.parametrize("content", [b"", b"plain text", b"glTF", b"[1]", PNG_SIGNATURE, b"glTF" + bytes(16)])
@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_a_file_that_is_no_gltf_is_one_plain_sentence(content: bytes, suffix: str, tmp_path: Path) -> None:
    file = tmp_path / f"a.{suffix}"
    file.write_bytes(content)
    for read in (load_mesh_asset, read_gltf, check_geometry):
        with pytest.raises(InputError) as caught:
            read(file)
        assert str(caught.value).startswith(f"{file} is not a glTF file, or a damaged one; give it the ending of its")


def test_the_texture_of_a_ply_is_its_base_colour(tmp_path: Path) -> None:
    codes = np.random.default_rng(0).integers(0, 256, (6, 4, 3)).astype(np.uint8)
    write_png(tmp_path / "a b.png", codes)
    header = "ply\nformat ascii 1.0\n{}element vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    rows = "end_header\n0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n3 0 1 2\n"
    text = (
        header + "property float s\nproperty float t\nelement face 1\nproperty list uchar int vertex_indices\n" + rows
    )
    file = tmp_path / "a.ply"
    file.write_text(text.format("comment TextureFile a b.png\n"))
    np.testing.assert_allclose(load_mesh_asset(file).material.diffuse_albedo, srgb_to_linear(codes / 255), atol=1e-6)
    red = load_mesh_asset(file, MaterialOverrides(base_color=(1.0, 0.0, 0.0))).material.diffuse_albedo
    np.testing.assert_array_equal(red, [1, 0, 0])
    file.write_text(text.format(""))
    np.testing.assert_array_equal(load_mesh_asset(file).material.diffuse_albedo, [0.5] * 3)
    for comments, message in {
        "comment TextureFile gone.png\n": r"a\.ply names 'gone\.png', which is not in its folder; put it beside",
        "comment TextureFile ../t.png\n": "outside its folder",
        "comment TextureFile a.png\ncomment TextureFile b.png\n": r"a\.ply has 2 textures; an asset has one: bake",
    }.items():
        file.write_text(text.format(comments))
        with pytest.raises(InputError, match=message):
            load_mesh_asset(file)


def test_numbers_and_colours_are_parsed() -> None:
    assert (
        parse_material_override("base_color", "0.1,0.2,0.3") == (0.1, 0.2, 0.3)
        and parse_material_override("roughness", "0.4") == 0.4
    )
