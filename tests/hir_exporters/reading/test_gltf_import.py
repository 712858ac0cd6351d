"""Materials of glTF files of any program: which one is read, and what an asset cannot represent."""

from __future__ import annotations

import base64
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hir_exporters.asset import Asset
from hir_exporters.conventions import srgb_to_linear
from hir_exporters.errors import InputError
from hir_exporters.format_options import GltfConfig
from hir_exporters.formats import create_exporter
from hir_exporters.reading.gltf_readback import read_gltf
from hir_exporters.reading.material_overrides import MaterialOverrides
from hir_exporters.reading.mesh_import import load_mesh_asset
from PIL import Image

from tests.fixtures.gltf_quads import FACES, POSITIONS, UVS, png, textured, write_quad

Json = dict[str, Any]

CODES = np.random.default_rng(0).integers(1, 255, (4, 4, 3)).astype(np.uint8)
IMAGE = png(Image.fromarray(CODES))
WHITE = png(Image.new("RGBA", (2, 2), "white"))
BLACK = png(Image.new("RGB", (2, 2), "black"))
CLEAR = png(Image.new("RGBA", (2, 2), (255, 255, 255, 128)))
COLORS = np.tile(np.array([1, 0, 0, 1], np.float32), (4, 1))


def warned(path: Path) -> list[str]:
    """The warnings about a file."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load_mesh_asset(path)
    return [str(warning.message) for warning in caught]


def extension(name: str, **value: object) -> Json:
    return textured() | {"extensions": {f"KHR_materials_{name}": value}}


@pytest.mark.parametrize(
    ("material", "words"),
    [
        (textured() | {"emissiveFactor": [0, 0.5, 0]}, "emission"),
        (textured() | {"emissiveFactor": [1, 1, 1], "emissiveTexture": {"index": 0}}, "emission"),
        (textured() | {"occlusionTexture": {"index": 0}}, "ambient occlusion"),
        (textured(baseColorFactor=[1, 1, 1, 0.5]) | {"alphaMode": "BLEND"}, r"opacity \(alphaMode BLEND\)"),
        ({"pbrMetallicRoughness": {"baseColorTexture": {"index": 3}}, "alphaMode": "BLEND"}, "opacity"),
        (textured(baseColorFactor=[1, 1, 1, 0.4]) | {"alphaMode": "MASK"}, r"opacity \(alphaMode MASK\)"),
        (textured() | {"doubleSided": True}, r"the back of its open surface \(doubleSided\)"),
        (extension("clearcoat", clearcoatFactor=1), r"clear coat \(KHR_materials_clearcoat\)"),
        (extension("transmission", transmissionFactor=0.5), "transmission"),
        (extension("sheen", sheenColorFactor=[0, 0, 0.5]), "sheen"),
        (extension("iridescence", iridescenceFactor=1), "iridescence"),
        (extension("anisotropy", anisotropyStrength=-0.5), "anisotropy"),
        (extension("volume", thicknessFactor=1), "volume"),
        (extension("unlit"), r"unlit shading \(KHR_materials_unlit; its colour is read as that of a rough dielectric"),
        (extension("of_tomorrow"), "KHR_materials_of_tomorrow"),
    ],
)
def test_what_is_left_out_is_named(material: Json, words: str, tmp_path: Path) -> None:
    path = write_quad(tmp_path / "a.glb", material, [IMAGE, WHITE, BLACK, CLEAR])
    with pytest.warns(UserWarning, match=rf"a\.glb is read without {words}.*, which cannot be represented; bake"):
        load_mesh_asset(path)


@pytest.mark.parametrize(
    "material",
    [
        textured() | {"emissiveFactor": [1, 1, 1], "emissiveTexture": {"index": 2}},
        textured() | {"emissiveTexture": {"index": 0}},
        textured() | {"occlusionTexture": {"index": 1}},
        textured() | {"occlusionTexture": {"index": 0, "strength": 0}},
        textured(baseColorFactor=[1, 1, 1, 0.5]) | {"alphaMode": "OPAQUE"},
        textured() | {"alphaMode": "BLEND"},
        textured(baseColorFactor=[1, 1, 1, 0.4]) | {"alphaMode": "MASK", "alphaCutoff": 0.3},
        extension("clearcoat", clearcoatRoughnessFactor=1),
        extension("sheen", sheenRoughnessFactor=0.5),
        extension("emissive_strength", emissiveStrength=5),
        extension("ior", ior=1.4),
    ],
)
def test_a_neutral_value_is_not_named(material: Json, tmp_path: Path) -> None:
    assert warned(write_quad(tmp_path / "a.glb", material, [IMAGE, WHITE, BLACK])) == []


def test_one_sentence_names_all(tmp_path: Path) -> None:
    material = extension("clearcoat", clearcoatFactor=1) | {"alphaMode": "BLEND", "emissiveFactor": [1, 1, 1]}
    path = write_quad(tmp_path / "a.glb", material, [CLEAR], {"COLOR_0": COLORS})
    (sentence,) = warned(path)
    listed = "opacity (alphaMode BLEND), emission, clear coat (KHR_materials_clearcoat) and vertex colours (COLOR_0)"
    assert sentence.startswith(f"{path} is read without {listed}, which cannot be represented; bake ")


@pytest.mark.parametrize(
    ("colors", "named"),
    [
        (COLORS, True),
        (np.ones((4, 3), np.float32), False),
        (np.full((4, 4), 255, np.uint8), False),
        (np.full((4, 4), 254, np.uint8), True),
        (np.full((4, 4), 65535, np.uint16), False),
    ],
)
def test_vertex_colours_are_named_unless_they_are_white(colors: np.ndarray, named: bool, tmp_path: Path) -> None:
    path = write_quad(tmp_path / "a.glb", textured(), [IMAGE], {"COLOR_0": colors})
    assert any("vertex colours" in sentence for sentence in warned(path)) is named


def _compressed(path: Path, extension: str) -> None:
    """Compresses the colours of `path`, 8 bits for each of 4 channels, or with Draco the whole mesh."""
    document = json.loads(path.read_text())
    (primitive,), views = document["meshes"][0]["primitives"], document["bufferViews"]
    data = base64.b64decode(document["buffers"][0]["uri"].partition(",")[2])
    view = views[document["accessors"][primitive["attributes"]["COLOR_0"]]["bufferView"]]
    colors = np.frombuffer(data, np.uint8, 16, view["byteOffset"]).reshape(4, 4)
    if extension == "EXT_meshopt_compression":
        import meshopt

        stream = bytes(meshopt.encode_gltf_buffer(colors, mode="ATTRIBUTES"))
        location = {"buffer": 1, "byteLength": len(stream), "byteStride": 4, "count": 4, "mode": "ATTRIBUTES"}
        view["extensions"] = {extension: location}
    else:
        import DracoPy

        stream = DracoPy.encode(
            POSITIONS, FACES.reshape(-1, 3), colors=colors, tex_coord=UVS.astype(float), preserve_order=True
        )
        kinds = {a["attribute_type"]: a["unique_id"] for a in DracoPy.decode(stream).attributes}
        names = {"POSITION": 0, "COLOR_0": 2, "TEXCOORD_0": 3}
        del primitive["attributes"]["NORMAL"]
        for index in (primitive["indices"], *primitive["attributes"].values()):
            del document["accessors"][index]["bufferView"]
        attributes = {name: kinds[kind] for name, kind in names.items()}
        primitive["extensions"] = {extension: {"bufferView": len(views), "attributes": attributes}}
        views.append({"buffer": 1, "byteLength": len(stream)})
    uri = "data:application/octet-stream;base64," + base64.b64encode(stream).decode()
    document["buffers"].append({"byteLength": len(stream), "uri": uri})
    document["extensionsRequired"] = document["extensionsUsed"] = [extension]
    path.write_text(json.dumps(document))


@pytest.mark.parametrize("extension", ["EXT_meshopt_compression", "KHR_draco_mesh_compression"])
@pytest.mark.parametrize("code", [255, 254])
def test_compressed_colours_are_named_unless_they_are_white(code: int, extension: str, tmp_path: Path) -> None:
    colors = np.full((4, 4), code, np.uint8)
    path = write_quad(tmp_path / "a.gltf", textured(), [IMAGE], {"COLOR_0": colors})
    _compressed(path, extension)
    assert any("vertex colours" in sentence for sentence in warned(path)) is (code != 255)


@pytest.mark.parametrize(
    ("stored", "rows", "values", "named"),
    [
        (None, [0, 1, 2, 3], 255, False),
        (None, [0, 1, 2, 3], 254, True),
        (None, [0, 1, 2], 255, True),  # the fourth is black
        ([255, 9, 255, 9], [1, 3], 255, False),
        ([255, 255, 255, 255], [1, 3], 9, True),
        ([255, 9, 9, 255], [1], 255, True),
    ],
)
def test_sparse_colours_are_named_unless_they_are_white(
    stored: list[int] | None, rows: list[int], values: int, named: bool, tmp_path: Path
) -> None:
    colors = np.repeat(np.array(stored or [0] * 4, np.uint8)[:, None], 4, axis=1)
    path = write_quad(tmp_path / "a.gltf", textured(), [IMAGE], {"COLOR_0": colors})
    document = json.loads(path.read_text())
    accessor = document["accessors"][document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]]
    if stored is None:
        del accessor["bufferView"]
    data, first = np.array(rows, np.uint16).tobytes(), len(document["bufferViews"])
    accessor["sparse"] = {
        "count": len(rows),
        "indices": {"bufferView": first, "componentType": 5123},
        "values": {"bufferView": first, "byteOffset": len(data)},
    }
    data += bytes([values] * 4 * len(rows))
    document["bufferViews"].append({"buffer": 1, "byteLength": len(data)})
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    document["buffers"].append({"byteLength": len(data), "uri": uri})
    path.write_text(json.dumps(document))
    assert any("vertex colours" in sentence for sentence in warned(path)) is named


def test_a_closed_surface_needs_no_back(textured_asset: Asset, tmp_path: Path) -> None:
    """That of the fixture is a sphere, whose seam has a vertex for each side."""
    from pygltflib import GLTF2

    create_exporter("glb").write(textured_asset, tmp_path / "a.glb")
    document = GLTF2().load(str(tmp_path / "a.glb"))
    document.materials[0].doubleSided = True
    document.save(str(tmp_path / "a.glb"))
    assert warned(tmp_path / "a.glb") == []


@pytest.mark.parametrize("profile", ["khr", "metalrough", "blender"])
@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_our_own_files_have_no_warning(suffix: str, profile: Any, textured_asset: Asset, tmp_path: Path) -> None:
    path = tmp_path / f"a.{suffix}"
    create_exporter(suffix, GltfConfig(profile=profile)).write(textured_asset, path)
    assert warned(path) == []


def test_an_unlit_material_is_a_rough_dielectric(tmp_path: Path) -> None:
    unlit = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, "extensions": {"KHR_materials_unlit": {}}}
    with pytest.warns(UserWarning, match="unlit"):
        material = load_mesh_asset(write_quad(tmp_path / "a.glb", unlit, [IMAGE])).material
    assert material.model == "dielectric" and float(material.roughness.min()) == 1
    np.testing.assert_allclose(material.diffuse_albedo, srgb_to_linear(CODES / 255), atol=1e-5)


@pytest.mark.parametrize("scale", [0.1, 1.0, 2.5])
def test_the_scale_of_a_normal_map_is_that_of_its_tangents(scale: float, tmp_path: Path) -> None:
    vectors = png(Image.fromarray(np.random.default_rng(1).integers(140, 250, (4, 4, 3)).astype(np.uint8)))
    plain = textured() | {"normalTexture": {"index": 1}}
    scaled = textured() | {"normalTexture": {"index": 1, "scale": scale}}
    stored = read_gltf(write_quad(tmp_path / "a.glb", plain, [IMAGE, vectors])).normal
    normal = load_mesh_asset(write_quad(tmp_path / "b.glb", scaled, [IMAGE, vectors])).material.normal
    assert stored is not None and normal is not None
    expected = stored * [scale, scale, 1]
    np.testing.assert_allclose(normal, expected / np.linalg.norm(expected, axis=-1, keepdims=True), atol=1e-6)


@pytest.mark.parametrize("scale", [[2, 1, 1], [1, 1, -1], [1, 0, 1]])
def test_normals_are_turned_as_planes(scale: list[int], tmp_path: Path) -> None:
    """By the inverse transpose; those of a mesh without a thickness are of its triangles, which have no area."""
    normals = np.tile(np.array([0.6, 0, 0.8], np.float32), (4, 1))
    changes = {"nodes": [{"mesh": 0, "scale": scale}]}
    path = write_quad(tmp_path / "a.glb", {}, attributes={"NORMAL": normals}, changes=changes)
    expected = np.array([0, 1, 0]) if 0 in scale else np.array([0.6, 0, 0.8]) / scale
    found = load_mesh_asset(path).mesh.normals
    np.testing.assert_allclose(found, np.tile(expected / np.linalg.norm(expected), (4, 1)), atol=1e-6)


def test_materials_count_that_placed_triangles_have(tmp_path: Path) -> None:
    red, plain = textured(baseColorFactor=[1, 0, 0, 1]), textured()
    path = write_quad(tmp_path / "a.glb", None, [IMAGE])
    back = load_mesh_asset(path).material.diffuse_albedo

    def two(first: int | None, second: int | None, materials: list[Json]) -> Path:
        attributes = {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}
        primitives = [
            {"attributes": attributes, "indices": 3} | ({} if index is None else {"material": index})
            for index in (first, second)
        ]
        changes = {"meshes": [{"primitives": primitives}], "materials": materials}
        return write_quad(tmp_path / "b.glb", plain, [IMAGE], changes=changes)

    used = load_mesh_asset(two(1, 1, [plain, red])).material.diffuse_albedo
    assert not used[..., 1:].any() and used[..., 0].any(), "the second material alone is used"
    named = load_mesh_asset(two(0, 1, [plain | {"name": "a"}, plain | {"name": "b"}])).material.diffuse_albedo
    np.testing.assert_allclose(named, srgb_to_linear(CODES / 255), atol=1e-5)
    np.testing.assert_array_equal(load_mesh_asset(two(None, None, [plain])).material.diffuse_albedo, back)
    with pytest.raises(InputError, match=r"b\.glb has 2 materials; an asset has one: merge them first"):
        load_mesh_asset(two(0, 1, [plain, red]))
    with pytest.raises(InputError, match=r"b\.glb has 2 materials, one of them glTF's default, .*merge them first"):
        load_mesh_asset(two(0, None, [plain]))


def test_a_material_has_the_defaults_of_gltf(tmp_path: Path) -> None:
    bare = read_gltf(write_quad(tmp_path / "a.glb", {"name": "bare"})).surface
    np.testing.assert_array_equal(bare.base_color, np.ones(3))
    assert (float(bare.metallic), float(bare.roughness), bare.ior) == (1.0, 1.0, 1.5)
    old = {"extensions": {"KHR_materials_pbrSpecularGlossiness": {}}}
    found = read_gltf(write_quad(tmp_path / "a.glb", old)).specular_surface
    assert found is not None
    np.testing.assert_array_equal([*found.diffuse, *found.specular, found.roughness], [1, 1, 1, 1, 1, 1, 0])
    load_mesh_asset(tmp_path / "a.glb")


OVERRIDES = MaterialOverrides(base_color=(0.5, 0.25, 0.125), roughness=0.5, metallic=0.0)


@pytest.mark.parametrize("name", ["base_color", "roughness", "metallic"])
def test_a_specular_workflow_is_replaced_as_a_whole(name: str, tmp_path: Path) -> None:
    path = write_quad(tmp_path / "a.glb", {"extensions": {"KHR_materials_pbrSpecularGlossiness": {}}})
    one = MaterialOverrides(**{name: getattr(OVERRIDES, name)})
    with pytest.raises(
        InputError, match=r"a\.glb has .* \(KHR_materials_pbrSpecularGlossiness\), .*; give --base-color"
    ):
        load_mesh_asset(path, one)
    material = load_mesh_asset(path, OVERRIDES).material
    np.testing.assert_allclose(material.diffuse_albedo, [0.5, 0.25, 0.125], atol=1e-3)
    np.testing.assert_allclose(material.specular_albedo, 0.04, atol=1e-6)


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_an_unknown_required_extension_is_refused(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"a.{suffix}"
    write_quad(path, textured(), [IMAGE], changes={"extensionsRequired": ["EXT_texture_webp", "ACME_foo"]})
    with pytest.raises(InputError, match=r"a\.gl.* requires the glTF extension ACME_foo, .*; export it without"):
        load_mesh_asset(path)
    with pytest.raises(InputError, match="ACME_foo"):
        read_gltf(path)
    write_quad(path, textured(), [IMAGE], changes={"extensionsRequired": ["EXT_texture_webp", "KHR_materials_ior"]})
    load_mesh_asset(path)


def transform(texture: int = 0, **value: object) -> Json:
    return {"index": texture, "extensions": {"KHR_texture_transform": value}}


def test_a_transform_of_all_textures_is_one_of_the_coordinates(tmp_path: Path) -> None:
    reference = transform(offset=[0.5, 0.25], scale=[0.25, 0.5])
    material = {"pbrMetallicRoughness": {"baseColorTexture": reference, "metallicRoughnessTexture": reference}}
    path = write_quad(tmp_path / "a.glb", material, [IMAGE])
    expected = UVS * [0.25, 0.5] + [0.5, 0.25]
    np.testing.assert_allclose(load_mesh_asset(path).mesh.uvs, expected, atol=1e-6)
    np.testing.assert_allclose(read_gltf(path).corner_uvs.reshape(-1, 2), expected[[0, 1, 2, 0, 2, 3]], atol=1e-6)
    plain = write_quad(tmp_path / "b.glb", textured(baseColorTexture=transform(offset=[0, 0])), [IMAGE])
    np.testing.assert_allclose(load_mesh_asset(plain).mesh.uvs, UVS, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"baseColorTexture": {"index": 0, "texCoord": 1}}, "lies on the second texture coordinates"),
        ({"metallicRoughnessTexture": {"index": 0, "texCoord": 1}}, "lies on the second texture coordinates"),
        ({"metallicRoughnessTexture": transform(texCoord=1)}, "lies on the second texture coordinates"),
        ({"metallicRoughnessTexture": transform(scale=[2, 2])}, "has another transform"),
        ({"baseColorTexture": transform(rotation=1)}, "has a transform that rotates or mirrors it"),
        ({"baseColorTexture": transform(scale=[1, -1])}, "has a transform that rotates or mirrors it"),
    ],
)
def test_textures_that_lie_elsewhere_are_refused(change: Json, words: str, tmp_path: Path) -> None:
    path = write_quad(tmp_path / "a.glb", textured(**change), [IMAGE], {"TEXCOORD_1": UVS})
    with pytest.raises(InputError, match=rf"a\.glb: the texture image 0 {words}.*; bake it in the program"):
        load_mesh_asset(path)


@pytest.mark.parametrize(
    ("factor", "sampler", "words"),
    [
        ([3, 1], {"wrapS": 33071}, "is clamped"),
        ([1, 3], {"wrapT": 33648}, "is mirrored"),
        ([3, 1], {"wrapT": 33071}, ""),
        ([3, 3], {}, ""),
        ([1, 1], {"wrapS": 33071, "wrapT": 33648}, ""),
    ],
)
def test_a_texture_repeats_where_coordinates_leave_0_to_1(
    factor: list[float], sampler: Json, words: str, tmp_path: Path
) -> None:
    uvs = (UVS * np.asarray(factor)).astype(np.float32)
    changes = {"samplers": [sampler], "textures": [{"source": 0, "sampler": 0}]}
    path = write_quad(tmp_path / "a.glb", textured(), [IMAGE], {"TEXCOORD_0": uvs}, changes=changes)
    if not words:
        np.testing.assert_allclose(load_mesh_asset(path).mesh.uvs, uvs, atol=1e-6)
        return
    with pytest.raises(
        InputError, match=rf"a\.glb: the texture image 0 {words} where texture coordinates leave 0 to 1"
    ):
        load_mesh_asset(path)
