"""The base colour texture of mesh files: which one it is, and which files are refused."""

from __future__ import annotations

import base64
import json
import os
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hir_exporters.conventions import linear_to_srgb, srgb_to_linear
from hir_exporters.errors import InputError
from hir_exporters.reading.base_color_texture import named_files, read_base_color_texture
from hir_exporters.textures.image_files import encode_png, write_png
from PIL import Image

CODES = np.random.default_rng(0).integers(0, 256, (6, 4, 3)).astype(np.uint8)
VERTICES = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
FACE = "f 1/1 2/2 3/3\n"
PLY = (
    "ply\nformat ascii 1.0\n{comment}\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    "property float s\nproperty float t\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    "0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n3 0 1 2\n"
)


def write_obj(folder: Path, faces: str, library: str | None) -> Path:
    if library is not None:
        (folder / "a.mtl").write_text(library)
    (folder / "a.obj").write_text(f"mtllib a.mtl\n{VERTICES}{faces}")
    return folder / "a.obj"


def gltf(material: dict[str, object], images: list[dict[str, object]], **more: object) -> dict[str, object]:
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32).tobytes()
    return {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"uri": uri(positions), "byteLength": 36}],
        "images": images,
        "textures": [{"source": index} for index in range(len(images))],
        "materials": [material],
    } | more


def uri(data: bytes) -> str:
    return "data:application/octet-stream;base64," + base64.b64encode(data).decode()


def textured(**more: object) -> dict[str, object]:
    return {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, **more}}


@pytest.mark.parametrize("kind", ["obj", "ply", "glb", "gltf beside", "gltf embedded"])
def test_a_texture_comes_bit_for_bit(kind: str, tmp_path: Path) -> None:
    write_png(tmp_path / "a b.png", CODES)
    suffix = kind.partition(" ")[0]
    path = tmp_path / f"a.{suffix}"
    if suffix == "obj":
        # with another map, and a material that no face has
        write_obj(
            tmp_path,
            "usemtl one\n" + FACE,
            "newmtl one\nKd 0.2 0.2 0.2\n\tmap_Kd a b.png\nmap_Ks s.png\n\nnewmtl other\nmap_Kd gone.png\n",
        )
    elif suffix == "ply":
        path.write_text(PLY.format(comment="comment TextureFile a b.png"))
    elif suffix == "glb":
        white = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.fromarray(CODES))
        visual = trimesh.visual.TextureVisuals(np.eye(3)[:, :2], white)
        trimesh.Trimesh(np.eye(3), [[0, 1, 2]], visual=visual, process=False).export(path)
    else:
        image = {"uri": "a%20b.png"} if kind.endswith("beside") else {"uri": uri(encode_png(CODES))}
        path.write_text(json.dumps(gltf(textured(), [image])))
    found = read_base_color_texture(path)
    assert found is not None and found.dtype == np.uint8
    np.testing.assert_array_equal(found, CODES)
    names = {"obj": ["a.mtl", "a b.png"], "ply": ["a b.png"], "gltf beside": ["a b.png"]}.get(kind, [])
    assert [file.name for file in named_files(path)] == names


def test_a_factor_is_linear(tmp_path: Path) -> None:
    material = textured(baseColorFactor=[0.5, 1.0, 0.25, 1.0])
    (tmp_path / "a.gltf").write_text(json.dumps(gltf(material, [{"uri": uri(encode_png(CODES))}])))
    found = read_base_color_texture(tmp_path / "a.gltf")
    assert found is not None
    expected = linear_to_srgb(srgb_to_linear(CODES / 255) * [0.5, 1.0, 0.25]) * 255
    np.testing.assert_allclose(found, expected, atol=0.5 + 1e-9)


def test_specular_glossiness_has_its_own_texture(tmp_path: Path) -> None:
    old = {"KHR_materials_pbrSpecularGlossiness": {"diffuseTexture": {"index": 1}}}
    images: list[dict[str, object]] = [{"uri": uri(encode_png(CODES[::-1]))}, {"uri": uri(encode_png(CODES))}]
    (tmp_path / "a.gltf").write_text(json.dumps(gltf({**textured(), "extensions": old}, images)))
    found = read_base_color_texture(tmp_path / "a.gltf")
    assert found is not None
    np.testing.assert_array_equal(found, CODES)


@pytest.mark.parametrize("mode", ["L", "P", "RGBA", "CMYK", "I;16", "1"])
def test_pictures_of_any_kind_have_three_channels(mode: str, tmp_path: Path) -> None:
    grey = Image.fromarray(CODES[..., 0])
    image = Image.fromarray(CODES[..., 0].astype(np.uint16) * 257) if mode == "I;16" else grey.convert(mode)
    image.save(tmp_path / "t.tif")
    path = write_obj(tmp_path, "usemtl m\n" + FACE, "newmtl m\nmap_Kd t.tif\n")
    found = read_base_color_texture(path)
    assert found is not None and found.shape == CODES.shape
    expected = np.where(CODES[..., 0] >= 128, 255, 0) if mode == "1" else CODES[..., 0]
    if mode != "1":  # Pillow dithers
        np.testing.assert_array_equal(found, np.repeat(expected[..., None], 3, axis=2))
    else:
        assert set(np.unique(found)) <= {0, 255}


def test_materials_without_a_picture_have_no_texture(tmp_path: Path) -> None:
    assert read_base_color_texture(write_obj(tmp_path, "usemtl m\n" + FACE, "newmtl m\nKd x y\n")) is None
    (tmp_path / "b.obj").write_text(VERTICES + FACE)
    assert read_base_color_texture(tmp_path / "b.obj") is None
    (tmp_path / "a.ply").write_text(PLY.format(comment="comment made by hand"))
    assert read_base_color_texture(tmp_path / "a.ply") is None
    (tmp_path / "a.gltf").write_text(json.dumps(gltf({}, [])))
    assert read_base_color_texture(tmp_path / "a.gltf") is None


def test_options_precede_the_name_of_a_picture(tmp_path: Path) -> None:
    write_png(tmp_path / "t.png", CODES)
    found = read_base_color_texture(write_obj(tmp_path, "usemtl m\n" + FACE, "newmtl m\nmap_Kd -clamp on t.png\n"))
    assert found is not None
    np.testing.assert_array_equal(found, CODES)


def test_materials_that_share_a_picture_have_one_texture(tmp_path: Path) -> None:
    write_png(tmp_path / "t.png", CODES)
    path = write_obj(
        tmp_path, "usemtl a\n" + FACE + "usemtl b\n" + FACE, "newmtl a\nmap_Kd t.png\nnewmtl b\nmap_Kd t.png\n"
    )
    found = read_base_color_texture(path)
    assert found is not None
    np.testing.assert_array_equal(found, CODES)


def test_several_base_colours_are_one_sentence(tmp_path: Path) -> None:
    write_png(tmp_path / "t.png", CODES)
    write_png(tmp_path / "u.png", CODES)
    library = "newmtl a\nmap_Kd t.png\nnewmtl b\nmap_Kd u.png\nnewmtl c\nKd 1 0 0\n"
    for other, name in (("b", "u.png"), ("c", "the colour of 'c'"), ("d", "faces without a material")):
        path = write_obj(tmp_path, "usemtl a\n" + FACE + f"usemtl {other}\n" + FACE, library)
        with pytest.raises(InputError, match=r"a\.obj has 2 base colours \(t\.png, .*; bake them") as found:
            read_base_color_texture(path)
        assert name in str(found.value)
    (tmp_path / "a.ply").write_text(PLY.format(comment="comment TextureFile t.png\ncomment TextureFile u.png"))
    with pytest.raises(InputError, match=r"a\.ply has 2 base colours"):
        read_base_color_texture(tmp_path / "a.ply")
    twice = [{"primitives": [{"attributes": {"POSITION": 0}, "material": index} for index in (0, 1)]}]
    document = gltf(textured(), [{"uri": "t.png"}], materials=[textured(), {}], meshes=twice)
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"a\.gltf has 2 base colours \(t\.png, the colour of material 1\)"):
        read_base_color_texture(tmp_path / "a.gltf")


@pytest.mark.parametrize(
    ("reference", "words"),
    [
        ({"texCoord": 1}, "second texture coordinates"),
        ({"extensions": {"KHR_texture_transform": {"scale": [2, 2]}}}, "a transform"),
    ],
)
def test_other_texture_coordinates_are_refused(reference: dict[str, object], words: str, tmp_path: Path) -> None:
    material = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0, **reference}}}
    (tmp_path / "a.gltf").write_text(json.dumps(gltf(material, [{"uri": uri(encode_png(CODES))}])))
    with pytest.raises(InputError, match=words):
        read_base_color_texture(tmp_path / "a.gltf")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a\.obj names 'a\.mtl', which is not in its folder; put it"):
        read_base_color_texture(write_obj(tmp_path, FACE, None))
    path = write_obj(tmp_path, "usemtl m\n" + FACE, "newmtl m\nmap_Kd t.png\n")
    with pytest.raises(InputError, match=r"a\.obj names 't\.png', which is not in its folder; put it"):
        read_base_color_texture(path)
    assert [file.name for file in named_files(path)] == ["a.mtl"]
    (tmp_path / "a.gltf").write_text(json.dumps(gltf(textured(), [{"uri": "t.png"}])))
    with pytest.raises(InputError, match=r"a\.gltf names 't\.png'"):
        read_base_color_texture(tmp_path / "a.gltf")


@pytest.mark.parametrize("kind", ["obj", "ply", "gltf"])
@pytest.mark.parametrize("trick", ["outside", "link", "damaged", "huge", "not a picture"])
def test_a_file_of_a_stranger_is_refused(kind: str, trick: str, tmp_path: Path) -> None:
    """Each in one sentence; nothing outside the folder is read."""
    folder = tmp_path / "scan"
    folder.mkdir()
    write_png(tmp_path / "secret.png", CODES)
    name = "../secret.png" if trick == "outside" else "t.png"
    png = encode_png(CODES)
    if trick == "link":
        os.symlink(tmp_path / "secret.png", folder / "t.png")
    elif trick != "outside":
        size = (60_000).to_bytes(4, "big") * 2
        huge = png[:16] + size + png[24:]
        content = {"damaged": png[: len(png) // 2], "huge": huge, "not a picture": b"%!PS-Adobe-3.0\n"}[trick]
        (folder / "t.png").write_bytes(content)
    path = folder / f"a.{kind}"
    if kind == "obj":
        write_obj(folder, "usemtl m\n" + FACE, f"newmtl m\nmap_Kd {name}\n")
    elif kind == "ply":
        path.write_text(PLY.format(comment=f"comment TextureFile {name}"))
    else:
        path.write_text(json.dumps(gltf(textured(), [{"uri": name}])))
    with pytest.raises(InputError) as found:
        read_base_color_texture(path)
    assert "\n" not in str(found.value) and ("t.png" in str(found.value) or "a." in str(found.value))


def test_documents_of_any_structure_are_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "a.gltf"
    for change in (
        {"textures": []},
        {"images": []},
        {"materials": [[]]},
        {"materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "baseColorFactor": "red"}}]},
    ):
        path.write_text(json.dumps(gltf(textured(), [{"uri": uri(encode_png(CODES))}]) | change))
        with pytest.raises(InputError, match=r"a\.gltf") as found:
            read_base_color_texture(path)
        assert "\n" not in str(found.value)
