import dataclasses
import json
import struct
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.asset import Asset, AssetMaterial, AssetMesh
from hir_exporters.conventions import srgb_to_linear
from hir_exporters.errors import ExportError, InputError
from hir_exporters.format_options import GltfConfig
from hir_exporters.formats import create_exporter
from hir_exporters.materials import material_conversion
from hir_exporters.reading.file_verification import verify_file
from hir_exporters.reading.gltf_readback import read_gltf
from hir_exporters.reading.validators import validate_gltf
from hir_exporters.textures.image_files import read_ldr
from pygltflib import GLTF2

PROFILES = ["khr", "blender", "metalrough", "unity-legacy"]
Sphere = Callable[..., AssetMesh]
Texture = Callable[..., np.ndarray]


def document_of(path: Path) -> dict:
    data = path.read_bytes()
    if path.suffix == ".gltf":
        return json.loads(data)
    length = struct.unpack("<I", data[12:16])[0]
    return json.loads(data[20 : 20 + length])


def material_with(asset: Asset, **changes: object) -> Asset:
    return dataclasses.replace(asset, material=dataclasses.replace(asset.material, **changes))


@pytest.fixture
def assets(textured_asset: Asset, constant_asset: Asset, make_texture: Texture) -> dict[str, Asset]:
    """One asset for each way in which a material can be made of constants and textures."""
    plastic = AssetMaterial("dielectric", make_texture(16, 3, 0.1, 0.9), [0.04] * 3, 0.3)
    metal = AssetMaterial(
        "dielectric", [0.0] * 3, make_texture(16, 3, 0.4, 0.95), make_texture(16, 1, 0.1, 0.4)[..., 0]
    )
    part = np.full((16, 16, 3), 0.04, np.float32)
    part[:8] = [0.9, 0.7, 0.3]
    part_metal = AssetMaterial("dielectric", np.where(part > 0.04, 0, 0.5), part, 0.3)
    grey = make_texture(16, 1, 0.05, 0.3) * np.ones(3, np.float32)
    return {
        "textured": textured_asset,
        "constant": constant_asset,
        "plastic": dataclasses.replace(constant_asset, material=plastic),
        "metal": dataclasses.replace(constant_asset, material=metal),
        "part_metal": dataclasses.replace(constant_asset, material=part_metal),
        "grey_paper": material_with(textured_asset, model="paper", specular_albedo=grey),
        "color_paper": material_with(textured_asset, model="paper"),
    }


def test_unity_legacy_has_one_whole_set_of_textures(
    constant_asset: Asset, make_texture: Texture, tmp_path: Path
) -> None:
    """The metallic-roughness set, for readers without the extension, is reduced; what is read back is the whole one."""
    whole, metallic = 640, {"base_color": 512, "occlusion_roughness_metallic": 512}
    maps = {
        "diffuse_albedo": make_texture(whole, 3, 0.1, 0.8),
        "specular_albedo": make_texture(whole, 3, 0.02, 0.08, 1),
        "roughness": make_texture(whole, 1, 0.1, 0.5, 2)[..., 0],
    }
    asset = material_with(constant_asset, **maps)
    file = create_exporter("gltf", GltfConfig(profile="unity-legacy")).write(asset, tmp_path / "a.gltf").files[0]
    sides = {image["name"]: read_ldr(tmp_path / image["uri"]).shape[0] for image in document_of(file)["images"]}
    assert sides == {**metallic, "diffuse": whole, "specular_glossiness": whole}
    alone = material_conversion.to_gltf(asset.material, "unity-legacy").residual
    assert verify_file(file, asset, "unity-legacy").brdf < alone + 0.005


def test_every_profile_of_every_material_is_clean_for_the_validator(
    assets: dict[str, Asset], node_tools: Path, tmp_path: Path
) -> None:
    files = []
    for name, asset in assets.items():
        for profile in PROFILES:
            for suffix in ("glb", "gltf"):
                files.append(tmp_path / f"{name}-{profile}.{suffix}")
                create_exporter(suffix, GltfConfig(profile=profile)).write(asset, files[-1])
    for config in (GltfConfig(quantize=True), GltfConfig(image_format="jpeg"), GltfConfig(tangents="always")):
        files.append(tmp_path / f"option-{len(files)}.glb")
        create_exporter("glb", config).write(assets["textured"], files[-1])
    assert [f for f in validate_gltf(files, node_tools) if f.severity != "information"] == []


def test_leaving_tangents_out_is_the_one_thing_the_validator_minds(
    textured_asset: Asset, node_tools: Path, tmp_path: Path
) -> None:
    create_exporter("glb", GltfConfig(tangents="never")).write(textured_asset, tmp_path / "a.glb")
    assert [f.code for f in validate_gltf([tmp_path / "a.glb"], node_tools)] == [
        "MESH_PRIMITIVE_GENERATED_TANGENT_SPACE"
    ]


def test_the_validator_would_complain(textured_asset: Asset, node_tools: Path, tmp_path: Path) -> None:
    def spoil(document: object, asset: Asset) -> None:
        document.materials[0].pbrMetallicRoughness.metallicFactor = 7.0

    create_exporter("glb").write(textured_asset, tmp_path / "a.glb", spoil)
    assert [f.severity for f in validate_gltf([tmp_path / "a.glb"], node_tools)] == ["error"]


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
@pytest.mark.parametrize("profile", PROFILES)
def test_what_others_read_back_is_what_was_asked_for(
    assets: dict[str, Asset], profile: str, suffix: str, tmp_path: Path
) -> None:
    for name, asset in assets.items():
        path = tmp_path / f"{name}.{suffix}"
        report = create_exporter(suffix, GltfConfig(profile=profile)).write(asset, path)
        check = verify_file(path, asset, profile)
        assert check.problems == () and check.positions == 0 and check.uvs < 1e-7 and check.normals_degrees < 1e-4
        # 8 bits of sRGB and of sqrt(alpha) are what is lost on top of the conversion.
        assert check.brdf == pytest.approx(report.residuals[profile], abs=0.01), name


def test_textures_are_the_converted_values_in_their_colour_space(textured_asset: Asset, tmp_path: Path) -> None:
    create_exporter("glb").write(textured_asset, tmp_path / "a.glb")
    back = read_gltf(tmp_path / "a.glb")
    wanted = material_conversion.to_gltf(textured_asset.material, "khr")
    half_code = srgb_to_linear(np.float64(1.0)) - srgb_to_linear(np.float64(254.4 / 255))
    np.testing.assert_allclose(back.surface.base_color, wanted.base_color, atol=half_code)
    np.testing.assert_allclose(back.surface.roughness, wanted.roughness, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(back.surface.specular_color, wanted.specular_color, atol=half_code * 2)
    assert back.normal is not None
    np.testing.assert_allclose(back.normal, textured_asset.material.normal, atol=1 / 255 + 1e-6)


def test_constants_are_factors_and_need_no_images(constant_asset: Asset, tmp_path: Path) -> None:
    create_exporter("glb").write(constant_asset, tmp_path / "a.glb")
    document = document_of(tmp_path / "a.glb")
    assert not document.get("images") and not document.get("textures") and not document.get("samplers")
    assert document["materials"][0]["pbrMetallicRoughness"]["roughnessFactor"] == 0.5
    assert document["materials"][0]["extensions"]["KHR_materials_ior"] == {"ior": 1000.0}
    assert sorted(document["extensionsUsed"]) == ["KHR_materials_ior", "KHR_materials_specular"]
    assert "extensionsRequired" not in document


def test_glass_like_dielectric_is_core_gltf(assets: dict[str, Asset], tmp_path: Path) -> None:
    create_exporter("glb").write(assets["plastic"], tmp_path / "a.glb")
    document = document_of(tmp_path / "a.glb")
    assert "extensions" not in document["materials"][0] and not document.get("extensionsUsed")


def test_small_reflectances_use_all_eight_bits(textured_asset: Asset, tmp_path: Path) -> None:
    create_exporter("gltf").write(textured_asset, tmp_path / "a.gltf")
    extension = document_of(tmp_path / "a.gltf")["materials"][0]["extensions"]["KHR_materials_specular"]
    largest = float(textured_asset.material.specular_albedo.max()) / 0.04
    np.testing.assert_allclose(extension["specularColorFactor"], largest, rtol=1e-6)
    from hir_exporters.textures.image_files import read_ldr

    assert read_ldr(tmp_path / "a_gltf_specular.png").max() == 1


def test_indices_are_as_small_as_they_can_be(constant_asset: Asset, make_sphere: Sphere, tmp_path: Path) -> None:
    for rings, kind in ((8, 5123), (260, 5125)):
        asset = dataclasses.replace(constant_asset, mesh=make_sphere(rings, 260))
        create_exporter("glb").write(asset, tmp_path / "a.glb")
        document = document_of(tmp_path / "a.glb")
        assert document["accessors"][document["meshes"][0]["primitives"][0]["indices"]]["componentType"] == kind


@pytest.mark.parametrize("count", [1, 2])
def test_one_and_two_triangles(count: int, node_tools: Path, tmp_path: Path) -> None:
    mesh = AssetMesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]],
        [[0, 0, 1]] * 4,
        [[0, 1], [1, 1], [0, 0], [1, 0]],
        [[0, 1, 2], [1, 3, 2]][:count],
    )
    asset = Asset(mesh, AssetMaterial("paper", [0.5] * 3, [0.1] * 3, 0.3), name="plate")
    create_exporter("glb").write(asset, tmp_path / "a.glb")
    assert {f.code for f in validate_gltf([tmp_path / "a.glb"], node_tools)} == {
        "UNUSED_OBJECT"
    }  # UVs without textures
    assert verify_file(tmp_path / "a.glb", asset).problems == ()


def test_tangents_come_with_normal_maps_and_agree_with_the_fit(textured_asset: Asset, tmp_path: Path) -> None:
    from hir_exporters.mesh.tangents import with_tangents

    create_exporter("glb").write(textured_asset, tmp_path / "a.glb")
    document = document_of(tmp_path / "a.glb")
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    accessor = document["accessors"][attributes["TANGENT"]]
    view = document["bufferViews"][accessor["bufferView"]]
    data = (tmp_path / "a.glb").read_bytes()
    start = 28 + struct.unpack("<I", data[12:16])[0] + view["byteOffset"]
    tangents = np.frombuffer(data, "<f4", accessor["count"] * 4, start).reshape(-1, 4)
    np.testing.assert_allclose(tangents, with_tangents(textured_asset.mesh).tangents, atol=1e-6)
    create_exporter("glb").write(material_with(textured_asset, normal=None), tmp_path / "b.glb")
    assert "TANGENT" not in document_of(tmp_path / "b.glb")["meshes"][0]["primitives"][0]["attributes"]


def test_quantized_mesh_is_within_its_steps(textured_asset: Asset, tmp_path: Path) -> None:
    create_exporter("glb", GltfConfig(quantize=True)).write(textured_asset, tmp_path / "q.glb")
    create_exporter("glb").write(textured_asset, tmp_path / "f.glb")
    document = document_of(tmp_path / "q.glb")
    assert document["extensionsRequired"] == ["KHR_mesh_quantization"]
    assert (tmp_path / "q.glb").stat().st_size < (tmp_path / "f.glb").stat().st_size
    node, primitive = document["nodes"][0], document["meshes"][0]["primitives"][0]
    accessor = document["accessors"][primitive["attributes"]["POSITION"]]
    view = document["bufferViews"][accessor["bufferView"]]
    data = (tmp_path / "q.glb").read_bytes()
    start = 28 + struct.unpack("<I", data[12:16])[0] + view["byteOffset"]
    rows = np.ndarray((accessor["count"], 3), "<i2", data, start, (view["byteStride"], 2))
    positions = rows / 32767 * node["scale"][0] + node["translation"]
    from hir_exporters.mesh.tangents import with_tangents

    np.testing.assert_allclose(positions, with_tangents(textured_asset.mesh).positions, atol=1.01 / 65534)
    check = verify_file(tmp_path / "q.glb", textured_asset)  # by a reader that applies the node and undoes the steps
    assert check.problems == () and 0 < check.positions < 1 / 65534 and 0 < check.uvs < 0.51 / 65535
    assert 0 < check.normals_degrees < 0.4


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_bytes_repeat_and_change_with_the_edit(textured_asset: Asset, suffix: str, tmp_path: Path) -> None:
    def vendor(document: object, asset: Asset) -> None:
        document.extensionsUsed.append("ACME_tag")
        document.materials[0].extensions["ACME_tag"] = {"name": asset.name}

    contents = []
    for folder, edit in (("a", None), ("b", None), ("c", vendor)):
        report = create_exporter(suffix).write(textured_asset, tmp_path / folder / f"x.{suffix}", edit)
        contents.append({path.name: path.read_bytes() for path in report.files})
        assert sorted(contents[-1]) == sorted(p.name for p in (tmp_path / folder).iterdir())
    assert contents[0] == contents[1] != contents[2]
    assert document_of(tmp_path / "c" / f"x.{suffix}")["materials"][0]["extensions"]["ACME_tag"] == {"name": "sphere"}


def test_provenance_is_in_the_file(textured_asset: Asset, tmp_path: Path) -> None:
    create_exporter("glb").write(textured_asset, tmp_path / "a.glb")
    assert document_of(tmp_path / "a.glb")["asset"]["extras"]["hir"] == {"source": "test"}


def test_names_with_spaces_and_letters_of_other_scripts_resolve(
    textured_asset: Asset, node_tools: Path, tmp_path: Path
) -> None:
    asset = dataclasses.replace(textured_asset, name="Kuh № 1")
    path = tmp_path / "eine Kuh №.gltf"
    create_exporter("gltf").write(asset, path)
    assert validate_gltf([path], node_tools) == []
    assert verify_file(path, asset).problems == ()


def test_larger_textures_are_reduced_and_a_budget_says_so(
    textured_asset: Asset, make_texture: Texture, tmp_path: Path
) -> None:
    asset = material_with(textured_asset, diffuse_albedo=make_texture(64, 3, 0.2, 0.8))
    create_exporter("glb", GltfConfig(max_texture_size=16)).write(asset, tmp_path / "a.glb")
    back = read_gltf(tmp_path / "a.glb")
    assert back.surface.base_color.shape == (16, 16, 3) and back.normal is not None and back.normal.shape == (16, 16, 3)
    mean = asset.material.diffuse_albedo.reshape(16, 4, 16, 4, 3).mean((1, 3))
    np.testing.assert_allclose(back.surface.base_color, mean, atol=0.006)
    large = material_with(textured_asset, roughness=np.broadcast_to(make_texture(4, 1, 0.1, 0.2)[:, :1, 0], (4, 4100)))
    report = create_exporter("glb", GltfConfig(budget="web")).write(large, tmp_path / "b.glb")
    assert any("4100 to 2048" in warning for warning in report.warnings)


def test_a_broken_asset_leaves_no_file(textured_asset: Asset, tmp_path: Path) -> None:
    broken = material_with(textured_asset, roughness=np.full((4, 4), np.nan))
    for suffix in ("glb", "gltf", "usda", "usdz", "obj"):
        with pytest.raises(InputError, match=r"material\.roughness"):
            create_exporter(suffix).write(broken, tmp_path / f"x.{suffix}")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ExportError, match="known formats are glb, gltf"):
        create_exporter("fbx")


def test_an_unwritable_destination_is_named(textured_asset: Asset, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for suffix in ("glb", "gltf", "usda", "usdz", "obj", "hdr", "exr"):
        with pytest.raises(ExportError, match=f"x.*{suffix}|x_|x.bin|x.mtl"):
            create_exporter(suffix).write(textured_asset, tmp_path / "file" / f"x.{suffix}")


def test_files_that_are_not_ours_are_read_or_refused_by_name(shared: Path) -> None:
    folder = shared / "hostile" / "gltf" / "models"
    files = [p for p in folder.rglob("*") if p.suffix in (".gltf", ".glb")]
    assert files
    for path in files:
        try:
            read_gltf(path)
        except InputError as error:
            assert path.name in str(error)


def test_draco_is_read_by_others_and_within_its_steps(textured_asset: Asset, node_tools: Path, tmp_path: Path) -> None:
    pytest.importorskip("DracoPy", reason="hir[compress] is not installed")
    for suffix in ("glb", "gltf"):
        path = tmp_path / f"d.{suffix}"
        create_exporter(suffix, GltfConfig(compression="draco")).write(textured_asset, path)
        create_exporter(suffix, GltfConfig()).write(textured_asset, tmp_path / f"f.{suffix}")
        document = document_of(path)
        assert document["extensionsRequired"] == ["KHR_draco_mesh_compression"]
        check = verify_file(path, textured_asset)
        assert check.problems == () and 0 < check.positions < 2 / 65535 and 0 < check.uvs < 2 / 16383
        assert 0 < check.normals_degrees < 0.1
        findings = validate_gltf([path], node_tools)
        assert {f.code for f in findings if f.severity != "information"} == set()
    sizes = [Path(tmp_path / name).stat().st_size for name in ("d.glb", "f.glb")]
    assert sizes[0] < sizes[1]


@pytest.mark.parametrize("quantize", [False, True])
def test_meshopt_is_read_by_others_and_loses_nothing(
    quantize: bool, textured_asset: Asset, node_tools: Path, tmp_path: Path
) -> None:
    pytest.importorskip("meshopt", reason="hir[compress] is not installed")
    for suffix in ("glb", "gltf"):
        path = tmp_path / f"m.{suffix}"
        create_exporter(suffix, GltfConfig(compression="meshopt", quantize=quantize)).write(textured_asset, path)
        create_exporter(suffix, GltfConfig(quantize=quantize)).write(textured_asset, tmp_path / f"f.{suffix}")
        document = document_of(path)
        wanted = ["EXT_meshopt_compression", *(["KHR_mesh_quantization"] if quantize else [])]
        assert sorted(document["extensionsRequired"]) == wanted
        check, plain = (verify_file(tmp_path / f"{name}.{suffix}", textured_asset) for name in ("m", "f"))
        assert check.problems == () and dataclasses.replace(check, file=plain.file) == plain
        findings = validate_gltf([path], node_tools)
        assert {f.code for f in findings if f.severity != "information"} == set()
    sizes = [Path(tmp_path / name).stat().st_size for name in ("m.glb", "f.glb")]
    assert sizes[0] < sizes[1]


def test_draco_is_refused_where_it_cannot_be(
    textured_asset: Asset, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with pytest.raises(ExportError, match="choose one"):
        create_exporter("glb", GltfConfig(compression="draco", quantize=True)).write(textured_asset, tmp_path / "a.glb")
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    with pytest.raises(ExportError, match=r"DracoPy.*hir\[compress\]"):
        create_exporter("glb", GltfConfig(compression="draco")).write(textured_asset, tmp_path / "a.glb")
    monkeypatch.setitem(sys.modules, "meshopt", None)
    with pytest.raises(ExportError, match=r"meshopt.*hir\[compress\]"):
        create_exporter("glb", GltfConfig(compression="meshopt")).write(textured_asset, tmp_path / "a.glb")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_xmp_says_which_program_made_the_file_of_which_capture(
    textured_asset: Asset, tmp_path: Path, suffix: str
) -> None:
    known = {"generator": "hir 9.9", "capture": "my spoon", "fingerprint": "abc123", "seed": 3}
    asset = dataclasses.replace(textured_asset, provenance=known)
    create_exporter(suffix, GltfConfig(xmp=True)).write(asset, tmp_path / f"x.{suffix}")
    document = GLTF2().load(str(tmp_path / f"x.{suffix}"))
    packets = document.extensions["KHR_xmp_json_ld"]["packets"]
    packet = packets[document.asset.extensions["KHR_xmp_json_ld"]["packet"]]
    assert packet["xmp:CreatorTool"] == "hir 9.9" and packet["dc:source"] == "my spoon"
    assert packet["dc:identifier"] == "abc123"
    assert packet["dc:title"]["rdf:_1"]["@value"] == textured_asset.name
    facts = packet["dc:description"]["rdf:_1"]["@value"]
    assert f"{len(asset.mesh.faces)} triangles" in facts and "100.0% of the texels were seen" in facts
    used = {word.partition(":")[0] for word in packet if not word.startswith("@")}
    assert used <= set(packet["@context"]), "every prefix is defined"
    assert "KHR_xmp_json_ld" in document.extensionsUsed


def test_there_is_no_xmp_by_default(textured_asset: Asset, tmp_path: Path) -> None:
    create_exporter("glb").write(textured_asset, tmp_path / "x.glb")
    assert "KHR_xmp_json_ld" not in GLTF2().load(str(tmp_path / "x.glb")).extensionsUsed
