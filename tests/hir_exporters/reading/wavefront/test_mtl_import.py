"""The material of an .obj: that which its faces use, the options of maps, and what is left out."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.asset import AssetMaterial
from hir_exporters.conventions import srgb_to_linear
from hir_exporters.errors import InputError
from hir_exporters.reading.base_color_texture import read_base_color_texture
from hir_exporters.reading.material_overrides import MaterialOverrides
from hir_exporters.reading.mesh_import import load_mesh_asset
from hir_exporters.reading.wavefront.mtl_statements import texture_map
from hir_exporters.reading.wavefront.obj_statements import library_names
from hir_exporters.textures.image_files import write_png

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
FIRST, SECOND = "f 1/1 2/2 3/3\n", "f 1/1 3/3 4/4\n"
CODES = np.random.default_rng(0).integers(0, 256, (6, 4, 3)).astype(np.uint8)
RED_AND_GREEN = "newmtl a\nKd 1 0 0\nnewmtl b\nKd 0 1 0\n"


def material_of(
    folder: Path, library: str | bytes, faces: str = "usemtl a\n" + FIRST, maps: MaterialOverrides | None = None
) -> AssetMaterial:
    (folder / "a.mtl").write_bytes(library if isinstance(library, bytes) else library.encode())
    (folder / "a.obj").write_text(f"mtllib a.mtl\n{SQUARE}{faces}")
    return load_mesh_asset(folder / "a.obj", maps).material


def normal_map(folder: Path, name: str) -> None:
    vectors = np.tile(np.array([0.1, -0.1, 0.99]), (4, 4, 1))
    vectors[0, 0] = [0.6, 0, 0.8]
    write_png(folder / name, vectors * 0.5 + 0.5)


def test_the_material_is_that_of_the_faces(tmp_path: Path) -> None:
    np.testing.assert_array_equal(material_of(tmp_path, RED_AND_GREEN, "usemtl b\n" + FIRST).diffuse_albedo, [0, 1, 0])
    unused = "usemtl a\nusemtl b\n" + FIRST + SECOND + "usemtl a\n"
    np.testing.assert_array_equal(material_of(tmp_path, RED_AND_GREEN, unused).diffuse_albedo, [0, 1, 0])
    np.testing.assert_array_equal(material_of(tmp_path, "newmtl a\nKd 1 0 0\n", FIRST).diffuse_albedo, [1, 0, 0])
    np.testing.assert_array_equal(material_of(tmp_path, "newmtl a\nKd 0.25\n", FIRST).diffuse_albedo, [0.25] * 3)


def test_materials_that_differ_are_refused(tmp_path: Path) -> None:
    faces = "usemtl a\n" + FIRST + "usemtl b\n" + SECOND
    with pytest.raises(InputError, match=r"a\.obj has 2 materials; an asset has one: merge them first"):
        material_of(tmp_path, RED_AND_GREEN, faces)
    same = "newmtl a\nKd 1 0 0\nKa 1 1 1\nnewmtl b\nKd 1 0 0\n"
    np.testing.assert_array_equal(material_of(tmp_path, same, faces).diffuse_albedo, [1, 0, 0])
    one = MaterialOverrides(base_color=(0.5, 0.25, 0.125))
    np.testing.assert_array_equal(material_of(tmp_path, RED_AND_GREEN, faces, one).diffuse_albedo, [0.5, 0.25, 0.125])


def test_a_material_that_is_not_there_is_a_warning(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match=r"a\.obj use the material 'c', which its \.mtl does not define, so they get"):
        material = material_of(tmp_path, RED_AND_GREEN, "usemtl c\n" + FIRST)
    np.testing.assert_array_equal(material.diffuse_albedo, [0.5] * 3)
    with pytest.warns(UserWarning, match=r"a\.obj have no usemtl, so they get the default material; export"):
        np.testing.assert_array_equal(material_of(tmp_path, RED_AND_GREEN, FIRST).diffuse_albedo, [0.5] * 3)
    (tmp_path / "b.obj").write_text(f"mtllib gone.mtl\n{SQUARE}usemtl a\n{FIRST}")
    with pytest.warns(UserWarning, match=r"b\.obj names 'gone\.mtl', which is not in its folder, .*; put it beside"):
        np.testing.assert_array_equal(load_mesh_asset(tmp_path / "b.obj").material.diffuse_albedo, [0.5] * 3)


@pytest.mark.parametrize("kind", ["mark", "tabs", "windows", "capitals", "two libraries", "spaces"])
def test_spellings_of_a_library(kind: str, tmp_path: Path) -> None:
    write_png(tmp_path / "t.png", CODES)
    library, names = "newmtl a\nmap_Kd t.png\nPr 0.25\n", "a.mtl"
    if kind == "tabs":
        library = library.replace(" ", "\t").replace("map", "\tmap")
    elif kind == "windows":
        library = library.replace("\n", "\r\n")
    elif kind == "capitals":
        library = library.replace("map_Kd", "map_kD").replace("Pr", "pr")
    elif kind == "two libraries":
        (tmp_path / "b.mtl").write_text("newmtl b\nKd 0 1 0\n")
        names = "b.mtl a.mtl"
    elif kind == "spaces":
        names = "my a.mtl"
    mark = b"\xef\xbb\xbf" if kind == "mark" else b""
    (tmp_path / names.split(".mtl ")[-1].removesuffix(".mtl")).with_suffix(".mtl").write_bytes(mark + library.encode())
    (tmp_path / "a.obj").write_bytes(mark + f"mtllib {names}\n{SQUARE}usemtl a\n{FIRST}".encode())
    material = load_mesh_asset(tmp_path / "a.obj").material
    np.testing.assert_allclose(material.diffuse_albedo, srgb_to_linear(CODES / 255), atol=1e-6)
    np.testing.assert_allclose(material.roughness, 0.25**2, rtol=1e-6)
    texture = read_base_color_texture(tmp_path / "a.obj")
    assert texture is not None
    np.testing.assert_array_equal(texture, CODES)


@pytest.mark.parametrize(
    ("value", "name", "options"),
    [
        ("my tex.png", "my tex.png", {}),
        ("my  tex.png", "my  tex.png", {}),
        ("-bm 1.0 n.png", "n.png", {"-bm": ("1.0",)}),
        ("-s 2 my tex.png", "my tex.png", {"-s": ("2",)}),
        (
            "-S 1 1 1 -o 0 0 -clamp on a b c.png",
            "a b c.png",
            {"-s": ("1", "1", "1"), "-o": ("0", "0"), "-clamp": ("on",)},
        ),
        ("-imfchan r -mm 0 1 1 2.png", "1 2.png", {"-imfchan": ("r",), "-mm": ("0", "1")}),
        ("-bm", "-bm", {}),
        ("-new 1 t.png", "-new 1 t.png", {}),
    ],
)
def test_options_precede_a_name_with_spaces(value: str, name: str, options: dict[str, tuple[str, ...]]) -> None:
    found = texture_map(value)
    assert (found.name, dict(found.options)) == (name, options)


def test_names_of_libraries() -> None:
    assert library_names("a.mtl") == ["a.mtl"]
    assert library_names("my a.mtl my b.MTL") == ["my a.mtl", "my b.MTL"]
    assert library_names("plain") == ["plain"] and library_names("") == []


def test_a_map_whose_options_change_it_is_refused(tmp_path: Path) -> None:
    write_png(tmp_path / "my tex.png", CODES)
    neutral = "newmtl a\nmap_Kd -s 1 1 1 -o 0 0 0 -mm 0 1 -clamp on my tex.png\n"
    np.testing.assert_allclose(material_of(tmp_path, neutral).diffuse_albedo, srgb_to_linear(CODES / 255), atol=1e-6)
    for option in ("-s 2 2 1", "-o 0.5", "-t 0.1 0 0", "-mm 0.2 0.5"):
        with pytest.raises(InputError, match=rf"a\.mtl, line 2: map_Kd has the option {option}, which.*; bake"):
            material_of(tmp_path, f"newmtl a\nmap_Kd {option} my tex.png\n")
        with pytest.raises(InputError, match=rf"the texture my tex\.png has the option {option}; bake it"):
            read_base_color_texture(tmp_path / "a.obj")
    material_of(tmp_path, "newmtl a\nmap_Pr -imfchan g my tex.png\n")
    with pytest.raises(InputError, match=r"map_Pr has the option -imfchan r, which.* grey image"):
        material_of(tmp_path, "newmtl a\nmap_Pr -imfchan r my tex.png\n")


@pytest.mark.parametrize("statement", ["map_Bump -bm 1.0", "bump", "map_bump", "norm"])
def test_a_normal_map_is_read_from_any_statement(statement: str, tmp_path: Path) -> None:
    normal_map(tmp_path, "n.png")
    material = material_of(tmp_path, f"newmtl a\n{statement} n.png\n")
    assert material.normal is not None
    np.testing.assert_allclose(material.normal[0, 0], [0.6, 0, 0.8], atol=0.01)


def test_a_height_map_is_left_out_with_a_warning(tmp_path: Path) -> None:
    write_png(tmp_path / "grey.png", CODES[..., :1])
    write_png(tmp_path / "h.png", CODES[..., :1].repeat(3, axis=2))
    for name in ("grey.png", "h.png"):
        with pytest.warns(UserWarning, match=rf"line 2: map_Bump names '{name}', a height map.*--normal") as found:
            assert material_of(tmp_path, f"newmtl a\nmap_Bump {name}\n").normal is None
        assert len(found) == 1
    normal_map(tmp_path, "n.png")
    given = material_of(tmp_path, "newmtl a\nmap_Bump h.png\n", maps=MaterialOverrides(normal=tmp_path / "n.png"))
    assert given.normal is not None, "and no warning, which would be an error here"


@pytest.mark.parametrize("statement", ["bump", "norm"])
@pytest.mark.parametrize("strength", [0.5, 2.0])
def test_the_bump_multiplier_scales_a_normal_map(strength: float, statement: str, tmp_path: Path) -> None:
    normal_map(tmp_path, "n.png")
    plain = material_of(tmp_path, "newmtl a\nnorm n.png\n").normal
    scaled = material_of(tmp_path, f"newmtl a\n{statement} -bm {strength} n.png\n").normal
    assert plain is not None and scaled is not None
    expected = plain * [strength, strength, 1]
    np.testing.assert_allclose(scaled, expected / np.linalg.norm(expected, axis=-1, keepdims=True), atol=1e-5)
    for wrong in ("nan", "x"):
        with pytest.raises(InputError, match=rf"line 2: {statement} "):
            material_of(tmp_path, f"newmtl a\n{statement} -bm {wrong} n.png\n")


@pytest.mark.parametrize(("color", "named"), [("0.6 0.6 0.6", False), ("0 0 0", False), ("0.6 0.6 1", True)])
def test_a_picture_replaces_the_colour_and_a_tint_is_named(color: str, named: bool, tmp_path: Path) -> None:
    write_png(tmp_path / "t.png", CODES)
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        material = material_of(tmp_path, f"newmtl a\nKd {color}\nmap_Kd t.png\n")
    np.testing.assert_allclose(material.diffuse_albedo, srgb_to_linear(CODES / 255), atol=1e-6)
    sentence = (
        f"{tmp_path / 'a.mtl'}, line 2: Kd is {color}, by which map_Kd is not multiplied; bake it into the picture"
    )
    assert [str(warning.message) for warning in found] == [sentence] * named


@pytest.mark.parametrize(
    ("statements", "named"),
    [
        ("d 0.5\nKe 1 0 0\nmap_d t.png", "d 0.5, Ke 1 0 0, map_d t.png"),
        ("Tr 0.5", "Tr 0.5"),
        ("disp t.png", "disp t.png"),
        ("d -halo 0.5", "d -halo 0.5"),
        ("Ks 0.5 0.5 0.5\nNs 250", "Ks 0.5 0.5 0.5, Ns 250 of the material 'a', .*--roughness"),
        ("map_Ks t.png", "map_Ks t.png of the material 'a', .*--roughness"),
        ("d 1\nd 1.0\nTr 0\nKe 0 0 0\nKa 1 1 1\nNi 1.45\nillum 2", ""),
        ("Ks 0.5 0.5 0.5\nNs 250\nPr 0.5", ""),
        ("Ks 0 0 0\nNs 250", ""),
    ],
)
def test_what_is_left_out_is_named_once(statements: str, named: str, tmp_path: Path) -> None:
    write_png(tmp_path / "t.png", CODES)
    library = f"newmtl a\nKd 1 0 0\n{statements}\nnewmtl unused\nd 0.1\n"
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        material_of(tmp_path, library)
    messages = [str(warning.message) for warning in found]
    assert len(messages) == bool(named)
    if named:
        with pytest.warns(UserWarning, match=rf"a\.obj: the import leaves out {named}"):
            material_of(tmp_path, library)


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("Kd nan 0 0", r"Kd is 'nan 0 0'; it must be from 0 to 1"),
        ("Kd 1 2 1", r"Kd is '1 2 1'; it must be from 0 to 1"),
        ("Kd 1 1", r"Kd is not three numbers"),
        ("Kd spectral f.rfl", r"Kd is 'spectral f\.rfl', not numbers"),
        ("Pr -1", r"Pr is '-1'; it must be from 0 to 1"),
        ("map_Kd gone.png", r"map_Kd names 'gone\.png', which is not in the folder of a\.obj"),
    ],
)
def test_a_malformed_statement_names_file_and_line(statement: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=rf"a\.mtl, line 3: {message}"):
        material_of(tmp_path, f"newmtl a\n\n{statement}\n")
