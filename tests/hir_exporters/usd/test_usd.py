import dataclasses
import importlib.util
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hir_exporters import usd_library
from hir_exporters.asset import Asset, AssetMesh
from hir_exporters.errors import ExportError, InputError
from hir_exporters.format_options import UsdConfig, UsdzConfig
from hir_exporters.formats import create_exporter
from hir_exporters.reading.file_verification import verify_file
from hir_exporters.reading.usd_reading.usd_import import read_untrusted_usd
from hir_exporters.reading.usd_reading.usd_readback import read_usd
from hir_exporters.reading.validators import validate_omniverse, validate_usd
from hir_exporters.usd.usdz_package import usdz_bytes
from pxr import Usd, UsdGeom

FORMATS = ["usda", "usdc", "usdz"]


@pytest.mark.parametrize("workflow", ["metallic", "specular"])
@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("kind", ["textured_asset", "constant_asset"])
def test_files_are_clean_and_say_what_was_asked_for(
    kind: str, suffix: str, workflow: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    asset = request.getfixturevalue(kind)
    config = (UsdzConfig if suffix == "usdz" else UsdConfig)(workflow=workflow)
    report = create_exporter(suffix, config).write(asset, tmp_path / f"x.{suffix}")
    layers = [path for path in report.files if path.suffix.startswith(".usd")]
    assert validate_usd(layers) == []
    check = verify_file(tmp_path / f"x.{suffix}", asset)
    assert check.problems == () and check.positions == 0 and check.normals_degrees < 1e-4
    assert check.brdf == pytest.approx(report.residuals[f"usd-{workflow}"], abs=0.01)


def test_the_other_validator_is_content_too(textured_asset: Asset, tmp_path: Path) -> None:
    core = pytest.importorskip("omni.asset_validator", reason="omniverse-asset-validator needs Python < 3.13")
    for suffix in FORMATS:
        report = create_exporter(suffix).write(textured_asset, tmp_path / f"x.{suffix}")
        for path in report.files:
            if path.suffix.startswith(".usd"):
                issues = core.ValidationEngine(init_rules=True).validate(str(path)).issues()
                # That a text file is slower to load than a binary one is what was asked for.
                issues_found = [
                    i for i in issues if i.severity != core.IssueSeverity.NONE and "Ascii" not in i.rule.__name__
                ]
                assert issues_found == [], path.name


@pytest.mark.parametrize("suffix", FORMATS)
def test_bytes_repeat_and_change_with_the_edit(textured_asset: Asset, suffix: str, tmp_path: Path) -> None:
    def vendor(stage: object, asset: Asset) -> None:
        stage.GetDefaultPrim().SetCustomDataByKey("acme", asset.name)

    contents = []
    for folder, edit in (("a", None), ("b", None), ("c", vendor)):
        report = create_exporter(suffix).write(textured_asset, tmp_path / folder / f"x.{suffix}", edit)
        contents.append({path.name: path.read_bytes() for path in report.files})
        assert sorted(contents[-1]) == sorted(p.name for p in (tmp_path / folder).iterdir())
    assert contents[0] == contents[1] != contents[2]


def test_package_is_stored_aligned_and_without_lights(textured_asset: Asset, tmp_path: Path) -> None:
    from pxr import Usd, UsdLux

    create_exporter("usdz").write(textured_asset, tmp_path / "x.usdz")
    data = (tmp_path / "x.usdz").read_bytes()
    with zipfile.ZipFile(tmp_path / "x.usdz") as package:
        assert package.testzip() is None
        entries = package.infolist()
    assert entries[0].filename == "sphere.usdc"
    for entry in entries:
        header = entry.header_offset
        name, extra = (int.from_bytes(data[header + k : header + k + 2], "little") for k in (26, 28))
        assert (header + 30 + name + extra) % 64 == 0 and entry.compress_type == zipfile.ZIP_STORED
    stage = Usd.Stage.Open(str(tmp_path / "x.usdz"))
    assert not [p for p in stage.Traverse() if p.HasAPI(UsdLux.LightAPI)]
    assert stage.GetDefaultPrim().GetName() == "sphere"


def test_package_holds_any_lengths_of_names_and_files(tmp_path: Path) -> None:
    files = [(f"{'n' * length}.png", bytes([length]) * length * 3) for length in range(1, 140)] + [("ä.png", b"")]
    path = tmp_path / "x.zip"
    path.write_bytes(usdz_bytes(files))
    with zipfile.ZipFile(path) as package:
        assert package.testzip() is None
        assert [(name, package.read(name)) for name in package.namelist()] == files


def test_light_lies_beside_the_asset_the_right_way_round(textured_asset: Asset, tmp_path: Path) -> None:
    from hir_exporters.textures.image_files import read_hdr
    from pxr import Usd, UsdGeom, UsdLux

    create_exporter("usda").write(textured_asset, tmp_path / "x.usda")
    stage = Usd.Stage.Open(str(tmp_path / "x_usda_lit.usda"))
    [light] = [UsdLux.DomeLight(p) for p in stage.Traverse() if p.IsA(UsdLux.DomeLight)]
    assert light.GetTextureFormatAttr().Get() == "latlong"
    assert UsdGeom.Xformable(light).GetLocalTransformation() == type(UsdGeom.Xformable(light).GetLocalTransformation())(
        1
    )
    radiance = read_hdr(Path(light.GetTextureFileAttr().Get().resolvedPath))
    height, width = radiance.shape[:2]
    # UsdLux: +Y is the top, longitude 0 (the middle) +Z, a quarter to the left +X.
    for row, column, color in [
        (0, 0, [0, 1, 0]),
        (height // 2, width // 2, [0, 0, 1]),
        (height // 2, width // 4, [1, 0, 0]),
    ]:
        np.testing.assert_allclose(radiance[row, column], color, atol=0.01)
    assert [p.GetName() for p in stage.Traverse() if p.IsA(UsdGeom.Mesh)] == ["Geometry"]


def test_stage_says_its_axes_units_and_provenance(textured_asset: Asset, tmp_path: Path) -> None:
    from pxr import Usd, UsdGeom

    create_exporter("usdc", UsdConfig(meters_per_unit=0.01)).write(textured_asset, tmp_path / "x.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "x.usdc"))
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and UsdGeom.GetStageMetersPerUnit(stage) == 0.01
    assert stage.GetDefaultPrim().GetCustomDataByKey("hir:source") == "test"


@pytest.mark.parametrize("name", ["Kuh № 1", "1st", "a-b", "Environment", "  x ", "日本"])
def test_any_name_is_a_prim_name(name: str, textured_asset: Asset, tmp_path: Path) -> None:
    report = create_exporter("usdz").write(dataclasses.replace(textured_asset, name=name), tmp_path / "x.usdz")
    assert validate_usd([path for path in report.files if path.suffix.startswith(".usd")]) == []


def test_nested_provenance_is_kept(textured_asset: Asset, tmp_path: Path) -> None:
    from pxr import Usd

    provenance = {"run": {"seed": 3, "stages": ["a", None], "ok": True, "big": 2**40}, "x y": 0.5}
    create_exporter("usda").write(dataclasses.replace(textured_asset, provenance=provenance), tmp_path / "x.usda")
    stage = Usd.Stage.Open(str(tmp_path / "x.usda"))
    data = stage.GetDefaultPrim().GetCustomDataByKey("hir")
    assert data["run"]["seed"] == 3 and data["run"]["stages"] == '["a", null]' and data["x_y"] == 0.5


def test_too_many_triangles_for_quick_look_are_reduced_with_a_warning(
    constant_asset: Asset, make_sphere: Callable[..., AssetMesh], tmp_path: Path
) -> None:
    asset = dataclasses.replace(constant_asset, mesh=make_sphere(225, 230))
    report = create_exporter("usdz").write(asset, tmp_path / "x.usdz")
    assert any("from 103040 to 100000" in warning or "from 103040 to 99999" in warning for warning in report.warnings)


@pytest.mark.parametrize(("format_name", "file"), [("usda", "x.glb"), ("usdz", "x.usda"), ("usda", "a@b.usda")])
def test_names_that_usd_cannot_have_are_refused(
    textured_asset: Asset, format_name: str, file: str, tmp_path: Path
) -> None:
    with pytest.raises(ExportError, match=file.replace(".", r"\.")):
        create_exporter(format_name).write(textured_asset, tmp_path / file)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["textured_asset", "constant_asset"])
def test_openpbr_lies_in_a_layer_of_its_own(kind: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    """The ids that usd-core does not know are all that validators report, and only of that layer."""
    from pxr import Usd, UsdShade

    create_exporter("usda", UsdConfig(materialx=True)).write(request.getfixturevalue(kind), tmp_path / "x.usda")
    layers = sorted(tmp_path.glob("*.usda"))
    found = {f.file.name: {g.code for g in validate_usd(layers) if g.file == f.file} for f in validate_usd(layers)}
    assert found == {"x_usda_openpbr.usda": {"MissingShaderIdInRegistry"}}
    stage = Usd.Stage.Open(str(tmp_path / "x_usda_openpbr.usda"))
    [material] = [UsdShade.Material(p) for p in stage.Traverse() if p.IsA(UsdShade.Material)]
    names = [material.ComputeSurfaceSource(context)[0].GetIdAttr().Get() for context in ("mtlx", "")]
    assert names == ["ND_open_pbr_surface_surfaceshader", "UsdPreviewSurface"]


def test_openpbr_uses_nodes_and_inputs_that_materialx_has(textured_asset: Asset, tmp_path: Path) -> None:
    materialx = pytest.importorskip("MaterialX", reason="the definitions are read from the wheel of MaterialX")
    from pxr import Usd, UsdShade

    definitions = materialx.createDocument()
    materialx.loadLibraries(materialx.getDefaultDataLibraryFolders(), materialx.getDefaultDataSearchPath(), definitions)
    create_exporter("usda", UsdConfig(materialx=True)).write(textured_asset, tmp_path / "x.usda")
    types = {"color3f": "color3", "float3": "vector3", "vector3f": "vector3", "float2": "vector2", "asset": "filename"}
    stage, count = Usd.Stage.Open(str(tmp_path / "x_usda_openpbr.usda")), 0
    for prim in stage.Traverse():
        shader = UsdShade.Shader(prim)
        if not shader or not str(shader.GetIdAttr().Get()).startswith("ND_"):
            continue
        definition = definitions.getNodeDef(shader.GetIdAttr().Get())
        assert definition is not None, shader.GetIdAttr().Get()
        for inputs in shader.GetInputs():
            declared = definition.getActiveInput(inputs.GetBaseName())
            assert declared is not None, inputs.GetFullName()
            kind = str(inputs.GetTypeName())
            assert declared.getType() == types.get(kind, kind), inputs.GetFullName()
            source = inputs.GetConnectedSources()[0]
            if source:
                given = definitions.getNodeDef(UsdShade.Shader(source[0].source.GetPrim()).GetIdAttr().Get())
                assert given.getActiveOutput(source[0].sourceName).getType() == declared.getType()
            count += 1
    assert count > 12


def test_openpbr_is_refused_where_it_cannot_be(textured_asset: Asset, tmp_path: Path) -> None:
    for suffix, config in (
        ("usda", UsdConfig(materialx=True, workflow="specular")),
        ("usdz", UsdzConfig(materialx=True)),
    ):
        with pytest.raises(ExportError, match="materialx"):
            create_exporter(suffix, config).write(textured_asset, tmp_path / f"x.{suffix}")
    assert list(tmp_path.iterdir()) == []


def test_what_no_view_saw_is_a_subset(textured_asset: Asset, tmp_path: Path) -> None:
    from pxr import Usd, UsdGeom

    seen = np.zeros((32, 32), bool)
    seen[:16] = True  # the upper half of the texture, which is the upper half of the sphere
    asset = dataclasses.replace(textured_asset, material=dataclasses.replace(textured_asset.material, observed=seen))
    create_exporter("usda").write(asset, tmp_path / "x.usda")
    stage = Usd.Stage.Open(str(tmp_path / "x.usda"))
    [mesh] = [UsdGeom.Mesh(p) for p in stage.Traverse() if p.IsA(UsdGeom.Mesh)]
    subsets = {
        s.GetPrim().GetName(): np.asarray(s.GetIndicesAttr().Get()) for s in UsdGeom.Subset.GetAllGeomSubsets(mesh)
    }
    height = asset.mesh.positions[asset.mesh.faces].mean(axis=1)[:, 1]
    np.testing.assert_array_equal(subsets["observed"], np.flatnonzero(height > 0))
    np.testing.assert_array_equal(subsets["unobserved"], np.flatnonzero(height < 0))
    assert UsdGeom.Subset.ValidateFamily(mesh, UsdGeom.Tokens.face, "observation")[0]
    assert validate_usd([tmp_path / "x.usda"]) == []
    create_exporter("usda", UsdConfig(subsets=False)).write(asset, tmp_path / "y.usda")
    create_exporter("usda").write(textured_asset, tmp_path / "z.usda")
    assert b"GeomSubset" not in (tmp_path / "y.usda").read_bytes() + (tmp_path / "z.usda").read_bytes()


def test_seams_of_the_texture_do_not_tear_the_surface(textured_asset: Asset, tmp_path: Path) -> None:
    """Charts may touch at a corner, with one UV or two: NVIDIA's rules mind such a vertex, and repeated values."""
    corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [-1, 1, 0], [-1, 0, 0], [-1, -1, 0], [0, -1, 0], [1, -1, 0]]
    uvs = np.asarray(corners, np.float32)[:, :2] / 2 + 0.5
    ring = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5], [0, 5, 6], [0, 6, 7], [0, 7, 8], [0, 8, 1]]
    # Two charts of two triangles keep their places in the texture, the other triangles have theirs moved by half.
    moved = np.concatenate([uvs, uvs + np.array([0, 1])])
    faces = [face if i in (0, 1, 4, 5) else [v + 9 for v in face] for i, face in enumerate(ring)]
    mesh = AssetMesh([*corners, *corners], [[0, 0, 1]] * 18, moved, faces)
    used, index = np.unique(mesh.faces, return_inverse=True)
    mesh = AssetMesh(mesh.positions[used], mesh.normals[used], mesh.uvs[used], index.reshape(-1, 3))
    asset = dataclasses.replace(textured_asset, mesh=mesh)
    for suffix in FORMATS:
        path = create_exporter(suffix).write(asset, tmp_path / f"x.{suffix}").files[0]
        stage = Usd.Stage.Open(str(path))
        prim = UsdGeom.Mesh(stage.GetDefaultPrim().GetChild("Geometry"))
        st = UsdGeom.PrimvarsAPI(prim).GetPrimvar("st")
        assert len(prim.GetPointsAttr().Get()) == 9 and st.GetInterpolation() == "faceVarying"
        assert len(st.GetIndices()) == 24 and len(st.Get()) == len(np.unique(mesh.uvs, axis=0))
        assert verify_file(path, asset).problems == () and validate_usd([path]) == []
        if importlib.util.find_spec("omni"):
            assert [f for f in validate_omniverse([path]) if f.severity != "information"] == []


def test_points_with_two_normals_stay_two(constant_asset: Asset, tmp_path: Path) -> None:
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0], [1, 0, 0], [0, 0, -1]]
    mesh = AssetMesh(corners, [[0, 0, 1]] * 3 + [[0, -1, 0]] * 3, np.zeros((6, 2)), [[0, 1, 2], [3, 4, 5]])
    path = create_exporter("usda").write(dataclasses.replace(constant_asset, mesh=mesh), tmp_path / "x.usda").files[0]
    stage = Usd.Stage.Open(str(path))
    assert len(UsdGeom.Mesh(stage.GetDefaultPrim().GetChild("Geometry")).GetPointsAttr().Get()) == 6


@pytest.mark.parametrize("suffix", FORMATS)
def test_without_its_library_the_extra_is_named(
    textured_asset: Asset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    path = tmp_path / f"x.{suffix}"
    create_exporter(suffix).write(textured_asset, path)
    before = path.read_bytes()
    monkeypatch.setattr(usd_library, "find_spec", lambda name: None)
    with pytest.raises(ExportError, match=rf"x\.{suffix}: USD files need usd-core; .* 'hir\[usd\]'$"):
        create_exporter(suffix).write(textured_asset, path)
    assert path.read_bytes() == before
    for read in (read_usd, read_untrusted_usd):
        with pytest.raises(InputError, match=r"pip install 'hir\[usd\]'$"):
            read(path)
