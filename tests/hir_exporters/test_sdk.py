"""The package as an integrator meets it: its README, its schema, what importing it costs."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import hir_exporters
import numpy as np
import pytest
from hir_exporters.asset import Asset, AssetMaterial, validate_asset
from hir_exporters.errors import ExportError, InputError
from hir_exporters.format_options import CubemapConfig, GltfConfig, UsdConfig, UsdzConfig
from hir_exporters.formats import FORMATS, create_exporter
from hir_exporters.materials import material_conversion
from hir_exporters.reading.environment_import import read_light
from hir_exporters.scene_format import save_scene
from hir_exporters.textures.image_files import write_exr

PACKAGE = Path(hir_exporters.__file__).parent
ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "exporters" / "README.md"
FORMATS_PAGE = ROOT / "docs" / "formats.md"


def test_the_readme_builds_an_asset_in_ten_lines(tmp_path: Path) -> None:
    [block] = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    assert len([line for line in block.splitlines() if line.strip()]) <= 10
    environment = {**os.environ, "PYTHONPATH": str(PACKAGE.parent)}
    subprocess.run([sys.executable, "-c", block], check=True, cwd=tmp_path, env=environment)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["tile.glb", "tile.hdr", "tile.mtl", "tile.obj", "tile_obj_base_color.png"]


def residual_rows() -> list[str]:
    rows = []
    for model in ("dielectric", "paper"):
        for specular in (0.02, 0.04, 0.08, 0.2):
            for alpha in (0.05, 0.3):
                material = AssetMaterial(model, [0.5] * 3, [specular] * 3, alpha)
                found = [
                    material_conversion.to_gltf(material, profile).residual
                    for profile in ("khr", "blender", "metalrough", "unity-legacy")
                ]
                rows.append(f"| {model} | {specular} | {alpha} | " + " | ".join(f"{x:.3f}" for x in found) + " |")
    return rows


def test_the_readme_states_the_residuals_that_the_code_computes() -> None:
    text = README.read_text(encoding="utf-8")
    table = text.split("<!-- residuals -->")[1].split("<!-- /residuals -->")[0].strip().splitlines()
    assert table[2:] == residual_rows(), "\n".join(residual_rows())


def formats_rows() -> list[str]:
    half = np.zeros((8, 8, 1)) + (np.arange(8) < 4)[:, None]
    materials_by_name = {
        "`paper`, grey lobe of 0.1": AssetMaterial("paper", [0.5, 0.4, 0.3], [0.1] * 3, 0.25),
        "`paper`, coloured lobe": AssetMaterial("paper", [0.3, 0.2, 0.1], [0.3, 0.2, 0.1], 0.25),
        "`dielectric`, ρs = 0.04": AssetMaterial("dielectric", [0.5, 0.4, 0.3], [0.04] * 3, 0.25),
        "`dielectric`, ρs = 0.08": AssetMaterial("dielectric", [0.5, 0.4, 0.3], [0.08] * 3, 0.25),
        "`dielectric`, coloured non-metal": AssetMaterial("dielectric", [0.3, 0.2, 0.1], [0.15, 0.08, 0.05], 0.25),
        "`dielectric`, gold": AssetMaterial("dielectric", [0.0] * 3, [0.9, 0.7, 0.3], 0.2),
        "half gold, half plastic": AssetMaterial(
            "dielectric", (1 - half) * 0.5 * np.ones(3), half * [0.86, 0.66, 0.26] + 0.04, 0.2
        ),
        "`metallic`, gold": AssetMaterial.metallic([0.9, 0.7, 0.3], 1.0, 0.2),
        "`metallic`, half gold, half plastic": AssetMaterial.metallic(
            np.where(half > 0, [0.9, 0.7, 0.3], 0.5), half[..., 0], 0.2
        ),
        "`metallic`, F0 = 0.08, half metal everywhere": AssetMaterial.metallic(
            [0.9, 0.7, 0.3], 0.5, 0.2, dielectric_f0=0.08
        ),
    }
    rows = []
    for name, material in materials_by_name.items():
        found = [
            material_conversion.to_gltf(material, p).residual for p in ("khr", "blender", "metalrough", "unity-legacy")
        ]
        found += [
            material_conversion.to_usd_metallic(material).residual,
            material_conversion.to_specular_workflow(material).residual,
        ]
        rows.append(f"| {name} | " + " | ".join(f"{x:.3f}" for x in found) + " |")
    return rows


def test_the_formats_page_states_the_schema_and_the_residuals() -> None:
    text = FORMATS_PAGE.read_text(encoding="utf-8")
    shown = text.split("<!-- schema -->")[1].split("<!-- /schema -->")[0].strip()
    assert shown == "```json\n" + (PACKAGE / "scene.schema.json").read_text(encoding="utf-8").strip() + "\n```"
    table = text.split("<!-- residuals -->")[1].split("<!-- /residuals -->")[0].strip().splitlines()
    assert table[2:] == formats_rows(), "\n".join(formats_rows())


def test_every_module_of_the_readme_exists() -> None:
    table = README.read_text(encoding="utf-8").split("## What is here")[1].split("## Formats")[0]
    for row in re.findall(r"^\| (`.*?`) \|", table, re.MULTILINE):
        for name in re.findall(r"`([\w/]+)`", row):
            assert (PACKAGE / name).is_dir() or (PACKAGE / f"{name}.py").is_file(), name
    folders = {entry.name for entry in PACKAGE.iterdir() if (entry / "__init__.py").is_file()}
    assert folders <= set(re.findall(r"`(\w+)/", table)), "the README names every folder"


@pytest.mark.parametrize("kind", ["textured_asset", "constant_asset"])
def test_saved_scenes_follow_the_schema(kind: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    jsonschema = pytest.importorskip("jsonschema", reason="the schema is checked with jsonschema")
    schema = json.loads((PACKAGE / "scene.schema.json").read_text())
    asset: Asset = request.getfixturevalue(kind)
    save_scene(asset, tmp_path / "s")
    document = json.loads((tmp_path / "s" / "scene.json").read_text())
    validator = jsonschema.Draft202012Validator(schema)
    validator.check_schema(schema)
    validator.validate(document)
    for path, value in ((["mesh"], "../mesh.ply"), (["material", "model"], "phong"), (["version"], 2)):
        spoiled = json.loads(json.dumps(document))
        table = spoiled
        for key in path[:-1]:
            table = table[key]
        table[path[-1]] = value
        assert list(validator.iter_errors(spoiled)), path


def imported(statement: str) -> set[str]:
    code = f"import sys; {statement}; print('\\n'.join(sys.modules))"
    environment = {**os.environ, "PYTHONPATH": str(PACKAGE.parent)}
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, env=environment)
    return {name.partition(".")[0] for name in done.stdout.split()}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"profile": "xyz"}, "profile is 'xyz'; it is one of 'khr'"),
        ({"image_format": "bmp"}, "image_format is 'bmp'; it is one of 'png'"),
        ({"max_texture_size": 0}, "max_texture_size is 0; it must be from 1 to 65536"),
        ({"jpeg_quality": 500}, "jpeg_quality is 500; it must be from 1 to 95"),
        ({"lods": (0,)}, "lods is 0; it must be from 1"),
        ({"lods": "10"}, "lods is '10'; it is a list of numbers"),
        ({"budget": "huge"}, "budget is 'huge'; it is one of 'none'"),
        ({"quantize": 1}, "quantize is 1; it is True or False"),
        ({"max_texture_size": 2.5}, "max_texture_size is 2.5; it is a whole number from 1 to 65536"),
        ({"max_texture_size": None}, "max_texture_size is None; it is a whole number from 1 to 65536"),
        ({"max_texture_size": np.ones(2)}, "max_texture_size is array([1., 1.]); it is a whole number from"),
        ({"profile": np.array(["khr"])}, "profile is array(['khr'], dtype='<U3'); it is one of"),
        ({"lods": {20, 10}}, "lods is {10, 20}; it is a list of numbers from 1 to"),
        ({"lods": None}, "lods is None; it is a list of numbers from 1 to"),
        ({"lods": ["10"]}, "lods is '10'; it is a whole number from 1 to"),
    ],
)
def test_options_are_checked_when_they_are_made(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match="^" + re.escape(message)):
        GltfConfig(**options)  # type: ignore[arg-type]
    assert GltfConfig(lods=[20, 10]).lods == (20, 10)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="meters_per_unit is nan"):
        UsdConfig(meters_per_unit=float("nan"))
    with pytest.raises(ValueError, match=r"meters_per_unit is 1(0{78})…; it is a number from 1e-09 to 1000000000$"):
        UsdConfig(meters_per_unit=10**400)
    with pytest.raises(ValueError, match="size is 100; it must be a power of two from 16 to 4096"):
        CubemapConfig(size=100)


def test_options_of_another_format_are_refused() -> None:
    with pytest.raises(ExportError, match=r"'glb' takes an instance of hir_exporters.GltfConfig; this is UsdzConfig"):
        create_exporter("glb", UsdzConfig())
    with pytest.raises(ExportError, match=r"takes an instance of hir_exporters.EnvironmentConfig; this is UsdConfig"):
        create_exporter("hdr", UsdConfig)


@pytest.mark.parametrize("name", FORMATS)
def test_a_file_name_of_another_format_is_refused(name: str, tmp_path: Path, textured_asset: Asset) -> None:
    with pytest.raises(ExportError, match=f"x.stl is not a file name of .*; it must end with .{name[:3]}"):
        create_exporter(name).write(textured_asset, tmp_path / "x.stl")
    assert not any(tmp_path.iterdir())


def test_a_field_of_another_type_is_named(constant_asset: Asset) -> None:
    with pytest.raises(InputError, match="environment is of the type ndarray; give an AssetEnvironment"):
        validate_asset(replace(constant_asset, environment=np.ones((4, 8, 3))))  # type: ignore[arg-type]


def test_negative_light_is_said(tmp_path: Path) -> None:
    radiance = np.ones((4, 8, 3), np.float32)
    radiance[0] = -0.5
    write_exr(tmp_path / "light.exr", radiance)
    with pytest.warns(UserWarning, match="light.exr has negative values, which become 0"):
        found = read_light(tmp_path / "light.exr")
    np.testing.assert_array_equal(found.radiance, np.maximum(radiance, 0))


def test_importing_costs_what_is_used() -> None:
    heavy = {"torch", "mitsuba", "drjit", "open3d", "pxr", "pygltflib", "trimesh", "scipy", "PIL", "hir_core", "pluggy"}
    assert not imported("import hir_exporters, hir_exporters.errors, hir_exporters.format_options") & (
        heavy | {"numpy"}
    )
    assert not imported("import hir_exporters.formats, hir_exporters.asset") & heavy


def test_no_module_reaches_upwards_or_for_torch() -> None:
    for path in PACKAGE.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"^\s*(import|from) (torch|mitsuba|pluggy|hir_core|hir_plugins)\b", text, re.MULTILINE), (
            path
        )
        assert len(text.splitlines()) <= 400, path


def test_public_names_resolve() -> None:
    for name in hir_exporters.__all__:
        assert getattr(hir_exporters, name) is not None
    with pytest.raises(AttributeError, match="no attribute"):
        _ = hir_exporters.nothing
