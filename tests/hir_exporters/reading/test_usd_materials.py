"""Materials of USD files that other programs wrote."""

import warnings
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.conventions import srgb_to_linear
from hir_exporters.errors import InputError
from hir_exporters.reading.material_overrides import MaterialOverrides
from hir_exporters.reading.mesh_import import load_mesh_asset
from hir_exporters.reading.usd_reading.usd_readback import read_usd
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, Vt

from tests.hir_exporters.reading.usd_samples import (
    COLOR,
    box_of,
    connect_texture,
    read_coordinates,
    surface_of,
    texture_of,
    write_box,
)

TYPES = Sdf.ValueTypeNames
CODES = np.asarray(COLOR, np.float32) / 255
LINEAR = srgb_to_linear(CODES)


@pytest.mark.parametrize(("space", "expected"), [(None, LINEAR), ("auto", LINEAR), ("sRGB", LINEAR), ("raw", CODES)])
def test_a_colour_of_eight_bits_is_srgb_unless_it_says_raw(
    space: str | None, expected: np.ndarray, tmp_path: Path
) -> None:
    def edit(stage: Usd.Stage) -> None:
        if space is not None:
            texture_of(stage).CreateInput("sourceColorSpace", TYPES.Token).Set(space)

    base_color = read_usd(write_box(tmp_path, edit)).surface.base_color
    np.testing.assert_allclose(base_color[0, 0], expected, atol=1e-6)


def test_data_and_float_pictures_are_linear(tmp_path: Path) -> None:
    from hir_exporters.textures.image_files import write_exr

    write_exr(tmp_path / "float.exr", np.full((2, 2, 3), 0.25, np.float32))

    def edit(stage: Usd.Stage) -> None:
        connect_texture(stage, "roughness", "g", "Roughness")
        texture_of(stage).GetInput("file").Set("./float.exr")

    surface = read_usd(write_box(tmp_path, edit)).surface
    np.testing.assert_allclose(surface.roughness, np.full((2, 2), CODES[1]), atol=1e-6)
    np.testing.assert_allclose(surface.base_color, 0.25, atol=1e-4)


def test_an_unknown_colour_space_is_refused(tmp_path: Path) -> None:
    path = write_box(tmp_path, lambda s: texture_of(s).CreateInput("sourceColorSpace", TYPES.Token).Set("acescg"))
    with pytest.raises(InputError, match=r"sourceColorSpace of /Root/Material/Color is 'acescg'; it is raw, sRGB or"):
        read_usd(path)


@pytest.mark.parametrize(("name", "expected"), [("scale", LINEAR * 0.5), ("bias", LINEAR + 0.5)])
def test_scale_and_bias_may_be_missing(name: str, expected: np.ndarray, tmp_path: Path) -> None:
    path = write_box(tmp_path, lambda stage: texture_of(stage).CreateInput(name, TYPES.Float4).Set(Gf.Vec4f(0.5)))
    np.testing.assert_allclose(read_usd(path).surface.base_color[0, 0], expected, atol=1e-6)


def test_a_normal_map_has_its_scale_and_bias(tmp_path: Path) -> None:
    def edit(stage: Usd.Stage, both: bool = True) -> None:
        texture = connect_texture(stage, "normal", "rgb", "Normal")
        texture.CreateInput("scale", TYPES.Float4).Set(Gf.Vec4f(2, -2, 2, 1))
        if both:
            texture.CreateInput("bias", TYPES.Float4).Set(Gf.Vec4f(-1, 1, -1, 0))

    normal = read_usd(write_box(tmp_path, edit)).normal
    assert normal is not None
    np.testing.assert_allclose(normal[0, 0], (2 * CODES - 1) * [1, -1, 1], atol=1e-6)
    (tmp_path / "plain").mkdir()
    path = write_box(tmp_path / "plain", lambda stage: connect_texture(stage, "normal", "rgb", "Normal"))
    with pytest.warns(UserWarning, match="normal map has no negative number; give its UsdUVTexture a scale of 2"):
        np.testing.assert_allclose(read_usd(path).normal[0, 0], CODES, atol=1e-6)


def _other_material(stage: Usd.Stage) -> UsdShade.Material:
    material = UsdShade.Material.Define(stage, "/Root/Other")
    shader = UsdShade.Shader.Define(stage, "/Root/Other/Surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("diffuseColor", TYPES.Color3f).Set((1, 0, 0))
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    return material


def _subset(stage: Usd.Stage, faces: range) -> None:
    subset = UsdGeom.Subset.CreateGeomSubset(box_of(stage), "part", "face", Vt.IntArray(faces), "materialBind")
    UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(_other_material(stage))


def test_several_materials_are_refused(tmp_path: Path) -> None:
    path = write_box(tmp_path, lambda stage: _subset(stage, range(3)))
    with pytest.raises(InputError, match=r"box.usda has 2 materials; an asset has one: merge them first$"):
        read_usd(path)


def test_a_material_of_a_subset_is_used(tmp_path: Path) -> None:
    path = write_box(tmp_path, lambda stage: _subset(stage, range(6)))
    assert read_usd(path).surface.base_color.tolist() == [1, 0, 0]

    def edit(stage: Usd.Stage) -> None:
        UsdShade.MaterialBindingAPI(box_of(stage)).UnbindAllBindings()
        _subset(stage, range(3))

    (tmp_path / "part").mkdir()
    path = write_box(tmp_path / "part", edit)
    with pytest.warns(UserWarning, match="has faces without a material, which get that of the others"):
        assert read_usd(path).surface.base_color.tolist() == [1, 0, 0]


def test_without_a_material_the_surface_is_grey(tmp_path: Path) -> None:
    path = write_box(tmp_path, lambda stage: stage.RemovePrim("/Root/Material"))
    assert read_usd(path).surface.base_color.tolist() == [0.5] * 3
    assert load_mesh_asset(path).material.diffuse_albedo.tolist() == pytest.approx([0.5] * 3, abs=0.03)


def test_a_material_of_another_renderer_is_refused(tmp_path: Path) -> None:
    path = write_box(tmp_path, lambda stage: surface_of(stage).GetIdAttr().Set("ND_standard_surface_surfaceshader"))
    with pytest.raises(InputError, match="the material /Root/Material has no UsdPreviewSurface; export it with one"):
        read_usd(path)


def test_what_an_asset_has_not_is_one_warning(tmp_path: Path) -> None:
    def edit(stage: Usd.Stage) -> None:
        surface = surface_of(stage)
        surface.CreateInput("opacity", TYPES.Float).Set(0.2)
        surface.CreateInput("emissiveColor", TYPES.Color3f).Set((1, 1, 1))
        surface.CreateInput("clearcoat", TYPES.Float).Set(0.0)

    path = write_box(tmp_path, edit)
    with pytest.warns(UserWarning) as caught:
        load_mesh_asset(path)
    [warning] = caught
    assert f"{path}: opacity and emissiveColor of its material are left out" in str(warning.message)


def test_neutral_inputs_are_no_warning(tmp_path: Path) -> None:
    """The alpha of a picture without alpha is 1."""

    def edit(stage: Usd.Stage) -> None:
        connect_texture(stage, "opacity", "a", "Opacity")
        surface_of(stage).CreateInput("occlusion", TYPES.Float).Set(1.0)

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_usd(write_box(tmp_path, edit))


def test_values_of_the_material_interface_are_followed(tmp_path: Path) -> None:
    def edit(stage: Usd.Stage) -> None:
        public = UsdShade.Material.Get(stage, "/Root/Material").CreateInput("rough", TYPES.Float)
        public.Set(0.125)
        surface_of(stage).CreateInput("roughness", TYPES.Float).ConnectToSource(public)

    assert float(read_usd(write_box(tmp_path, edit)).surface.roughness) == 0.125


def test_the_specular_workflow_is_read(tmp_path: Path) -> None:
    def edit(stage: Usd.Stage) -> None:
        surface_of(stage).CreateInput("useSpecularWorkflow", TYPES.Int).Set(1)
        surface_of(stage).CreateInput("specularColor", TYPES.Color3f).Set((0.5, 0.25, 0.125))

    specular = read_usd(write_box(tmp_path, edit)).specular_surface
    assert specular is not None and specular.specular.tolist() == [0.5, 0.25, 0.125]
    with pytest.raises(InputError, match=r"box\.usda has .* \(useSpecularWorkflow\), .*; give --base-color, "):
        load_mesh_asset(tmp_path / "box.usda", MaterialOverrides(roughness=0.5))


def test_overrides_replace_parameters_of_the_file(tmp_path: Path) -> None:
    path = write_box(tmp_path)
    material = load_mesh_asset(path, MaterialOverrides(roughness=0.5)).material
    np.testing.assert_allclose(material.roughness, 0.25, rtol=1e-6)
    np.testing.assert_allclose(material.diffuse_albedo, LINEAR, atol=1e-5)
    material = load_mesh_asset(path, MaterialOverrides(base_color=(0.2, 0.3, 0.4))).material
    np.testing.assert_allclose(material.diffuse_albedo, [0.2, 0.3, 0.4], rtol=1e-6)


def test_a_transform_of_the_texture_moves_the_coordinates(tmp_path: Path) -> None:
    """in * scale, then rotation, then translation: (1, 0) by 4 and 2, a quarter to the left, moved by (0.5, 0)."""

    def edit(stage: Usd.Stage) -> None:
        reader = read_coordinates(stage, "st")
        node = UsdShade.Shader.Define(stage, "/Root/Material/Transform")
        node.CreateIdAttr("UsdTransform2d")
        node.CreateInput("scale", TYPES.Float2).Set((4, 2))
        node.CreateInput("rotation", TYPES.Float).Set(90)
        node.CreateInput("translation", TYPES.Float2).Set((0.5, 0))
        node.CreateInput("in", TYPES.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
        node.CreateOutput("result", TYPES.Float2)
        texture_of(stage).GetInput("st").ConnectToSource(node.ConnectableAPI(), "result")

    uvs = read_usd(write_box(tmp_path, edit)).corner_uvs
    np.testing.assert_allclose(uvs[0] * [1, -1] + [0, 1], [[0.5, 0], [0.5, 4], [-1.5, 4]], atol=1e-6)


def test_textures_with_different_coordinates_are_refused(tmp_path: Path) -> None:
    def edit(stage: Usd.Stage) -> None:
        read_coordinates(stage, "st")
        connect_texture(stage, "roughness", "g", "Roughness")

    with pytest.raises(InputError, match=r"different texture coordinates or transforms \(primvars 'st', None\)"):
        read_usd(write_box(tmp_path, edit))


def _rename(stage: Usd.Stage, name: str) -> None:
    primvars = UsdGeom.PrimvarsAPI(box_of(stage))
    values = primvars.GetPrimvar("st").Get()
    primvars.RemovePrimvar("st")
    primvars.CreatePrimvar(name, TYPES.TexCoord2fArray, "faceVarying").Set(values)


@pytest.mark.parametrize("varname", [None, "UVMap"])
def test_coordinates_may_have_another_name(varname: str | None, tmp_path: Path) -> None:
    def edit(stage: Usd.Stage) -> None:
        _rename(stage, "UVMap")
        if varname is not None:
            read_coordinates(stage, varname)
            values = [(0, 0)] * 24
            UsdGeom.PrimvarsAPI(box_of(stage)).CreatePrimvar("st", TYPES.TexCoord2fArray, "faceVarying").Set(values)

    uvs = read_usd(write_box(tmp_path, edit)).corner_uvs
    np.testing.assert_array_equal(uvs[0], [[0, 1], [1, 1], [1, 0]])


def test_coordinates_that_are_missing_or_unclear_are_refused(tmp_path: Path) -> None:
    def missing(stage: Usd.Stage) -> None:
        UsdGeom.PrimvarsAPI(box_of(stage)).RemovePrimvar("st")

    def several(stage: Usd.Stage) -> None:
        _rename(stage, "b")
        UsdGeom.PrimvarsAPI(box_of(stage)).CreatePrimvar("a", TYPES.TexCoord2fArray, "constant").Set([(0, 0)])

    def other(stage: Usd.Stage) -> None:
        read_coordinates(stage, "map1")

    for edit, words in (
        (missing, r"mesh.uvs is missing; unwrap the mesh first"),
        (several, r"several texture coordinates \(a, b\)"),
        (other, r"read the primvar 'map1', which the mesh /Root/Box lacks; it has st"),
    ):
        folder = tmp_path / edit.__name__
        folder.mkdir()
        with pytest.raises(InputError, match=words):
            read_usd(write_box(folder, edit))


@pytest.mark.parametrize(
    ("file", "words"),
    [
        ("./gone.png", r"box.usda names './gone.png', which does not exist; put the file beside it$"),
        ("../outside.png", r"names '../outside.png', which is outside its folder; put the file beside it$"),
        ("", r"the texture /Root/Material/Color names no file"),
        ("./tile.<UDIM>.png", r"tiles of a texture; bake them to one texture first"),
        ("./box.usda", r"box.usda names './box.usda': an image is not an image that can be read"),
    ],
)
def test_pictures_that_cannot_be_read_are_refused(file: str, words: str, tmp_path: Path) -> None:
    folder = tmp_path / "box"
    folder.mkdir()
    (tmp_path / "outside.png").write_bytes(b"")
    path = write_box(folder, lambda stage: texture_of(stage).GetInput("file").Set(file))
    with pytest.raises(InputError, match=words):
        read_usd(path)


def test_a_wrap_mode_that_matters_is_a_warning(tmp_path: Path) -> None:
    def edit(stage: Usd.Stage, scale: float) -> None:
        texture_of(stage).CreateInput("wrapS", TYPES.Token).Set("clamp")
        st = UsdGeom.PrimvarsAPI(box_of(stage)).GetPrimvar("st")
        st.Set(Vt.Vec2fArray.FromNumpy(np.asarray(st.Get()) * np.float32(scale)))

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_usd(write_box(tmp_path, lambda stage: edit(stage, 1)))
    (tmp_path / "large").mkdir()
    path = write_box(tmp_path / "large", lambda stage: edit(stage, 2))
    with pytest.warns(UserWarning, match="outside of 0 to 1, where its textures have the wrap mode clamp"):
        read_usd(path)


def test_colours_of_a_mesh_without_material_are_a_warning(tmp_path: Path) -> None:
    def edit(stage: Usd.Stage) -> None:
        stage.RemovePrim("/Root/Material")
        box_of(stage).CreateDisplayColorAttr([(1, 0, 0)])

    with pytest.warns(UserWarning, match=r"colours in its meshes \(displayColor\) and no material; bake them"):
        read_usd(write_box(tmp_path, edit))
