"""The `metallic` model as data: glTF's parameters, the albedos of its lobes, the scene folder."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.asset import Asset, AssetMaterial, AssetMesh, describe, validate_asset
from hir_exporters.errors import InputError
from hir_exporters.scene_format import load_scene, save_scene

PACKAGE = Path(__file__).resolve().parents[2] / "exporters" / "hir_exporters"
PLATE = AssetMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 1]] * 3, [[0, 1], [1, 1], [0, 0]], [[0, 1, 2]])


def mixed(size: int = 16, seed: int = 0) -> AssetMaterial:
    """Metal, plastic and texels in between, in random colours; F0 0.06."""
    rng = np.random.default_rng(seed)
    metalness = rng.random((size, size))
    metalness[: size // 3], metalness[-size // 3 :] = 0, 1
    return AssetMaterial.metallic(
        rng.random((size, size, 3)), metalness, rng.uniform(0.01, 1, (size, size)), dielectric_f0=0.06
    )


def asset_of(material: AssetMaterial) -> Asset:
    return Asset(PLATE, material, name="plate")


def test_a_metal_and_a_non_metal_are_exact() -> None:
    rng = np.random.default_rng(1)
    base = rng.random((64, 64, 3)).astype(np.float32)
    for f0 in (0.04, 0.08):
        plastic = AssetMaterial.metallic(base, 0.0, 0.3, dielectric_f0=f0)
        np.testing.assert_array_equal(plastic.diffuse_albedo, base)
        np.testing.assert_array_equal(plastic.specular_albedo, np.full_like(base, f0))
        np.testing.assert_array_equal(plastic.base_color, base)
        metal = AssetMaterial.metallic(base, 1.0, 0.3, dielectric_f0=f0)
        np.testing.assert_array_equal(metal.diffuse_albedo, np.zeros_like(base))
        np.testing.assert_array_equal(metal.specular_albedo, base)
        np.testing.assert_array_equal(metal.base_color, base)


def test_albedos_are_those_of_the_gltf_specification_and_the_base_colour_comes_back() -> None:
    """c_diff = lerp(base, 0, m) and f0 = lerp(F0, base, m), glTF 2.0, appendix B.3.5; in float64 beside float32."""
    rng = np.random.default_rng(2)
    base, m = rng.random((32, 32, 3)), rng.random((32, 32))
    material = AssetMaterial.metallic(base, m, 0.3, dielectric_f0=0.05)
    np.testing.assert_allclose(material.diffuse_albedo, base * (1 - m[..., None]), atol=2e-7, rtol=0)
    np.testing.assert_allclose(material.specular_albedo, 0.05 + (base - 0.05) * m[..., None], atol=2e-7, rtol=0)
    np.testing.assert_allclose(material.base_color, base, atol=3e-7, rtol=0)
    validate_asset(asset_of(material))


def test_constants_and_textures_combine() -> None:
    texture = np.linspace(0, 1, 16, dtype=np.float32).reshape(4, 4)
    for base, m, size in (
        ([0.9, 0.6, 0.2], 0.5, ()),
        ([0.9, 0.6, 0.2], texture, (4, 4)),
        (np.tile(texture[..., None], 3), 0.5, (4, 4)),
    ):
        material = AssetMaterial.metallic(base, m, 0.3)
        validate_asset(asset_of(material))
        assert material.base_color.shape == (*size, 3)
        np.testing.assert_allclose(material.base_color, np.broadcast_to(base, (*size, 3)), atol=2e-7)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"metalness": None}, r"metalness is missing.*AssetMaterial.metallic"),
        ({"metalness": np.float32(1.5)}, "metalness ranges from 1.5"),
        ({"metalness": np.float32(np.nan)}, "metalness contains 1 NaN"),
        ({"metalness": np.zeros((2, 2, 1))}, r"metalness has the shape.*\(H, W\) or one number"),
        ({"metalness": np.float32(0.7)}, "differ by .* from those of metalness"),
        ({"dielectric_f0": 0.9}, "dielectric_f0 is 0.9; it must be one number from 0 to 0.5"),
        ({"dielectric_f0": float("nan")}, "dielectric_f0 is nan"),
        ({"diffuse_albedo": [0.5, 0.5, 0.5]}, "differ by .* make the material with AssetMaterial.metallic"),
        ({"specular_albedo": np.ones((2, 2, 3)), "metalness": np.ones((4, 4))}, "2 x 2 and 4 x 4"),
        ({"model": "dielectric"}, "metalness is set, but the model is 'dielectric'"),
        ({"model": "paper", "metalness": None, "dielectric_f0": 0.05}, "dielectric_f0 is set, but the model is 'pap"),
        ({"model": "velvet"}, "known are paper, dielectric, metallic"),
    ],
)
def test_what_is_not_a_metallic_material_is_refused(change: dict[str, object], message: str) -> None:
    material = AssetMaterial.metallic([0.8, 0.6, 0.4], 0.25, 0.3)
    validate_asset(asset_of(material))
    with pytest.raises(InputError, match=message):
        validate_asset(asset_of(dataclasses.replace(material, **change)))


def test_a_base_colour_above_one_and_textures_of_two_sizes_are_refused() -> None:
    with pytest.raises(InputError, match=r"base_color ranges from 0.5 to 1.2"):
        validate_asset(asset_of(AssetMaterial.metallic([0.5, 0.5, 1.2], 0.5, 0.3)))
    with pytest.raises(InputError, match=r"base_color is 8 x 4 and material\.metalness 3 x 5 texels"):
        AssetMaterial.metallic(np.ones((4, 8, 3)), np.ones((5, 3)), 0.3)
    with pytest.raises(InputError, match="'dielectric' has no base colour"):
        _ = AssetMaterial("dielectric", [0.5] * 3, [0.04] * 3, 0.3).base_color


@pytest.mark.parametrize("constant", [False, True])
def test_a_scene_folder_keeps_every_bit_and_follows_the_schema(constant: bool, tmp_path: Path) -> None:
    jsonschema = pytest.importorskip("jsonschema", reason="the schema is checked with jsonschema")
    material = AssetMaterial.metallic([0.9, 0.6, 0.2], 1.0, 0.1) if constant else mixed()
    save_scene(asset_of(material), tmp_path / "scene")
    loaded = load_scene(tmp_path / "scene").material
    for field in dataclasses.fields(material):
        np.testing.assert_array_equal(getattr(loaded, field.name), getattr(material, field.name), err_msg=field.name)
    document = json.loads((tmp_path / "scene" / "scene.json").read_text())
    assert document["material"]["metalness"] == (1.0 if constant else "metalness.exr")
    assert document["material"]["dielectric_f0"] == material.dielectric_f0
    validator = jsonschema.Draft202012Validator(json.loads((PACKAGE / "scene.schema.json").read_text()))
    validator.validate(document)
    assert list(validator.iter_errors({**document, "material": {**document["material"], "model": "dielectric"}}))
    del document["material"]["metalness"]
    assert list(validator.iter_errors(document))
    (tmp_path / "scene" / "scene.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"scene\.json: material\.metalness is missing"):
        load_scene(tmp_path / "scene")
    document["material"] |= {"metalness": 1, "dielectric_f0": "glass"}
    (tmp_path / "scene" / "scene.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match="dielectric_f0 contains a value that is not a number"):
        load_scene(tmp_path / "scene")


def test_scenes_of_the_other_models_have_no_entry_for_it(tmp_path: Path) -> None:
    save_scene(asset_of(AssetMaterial("dielectric", [0.5] * 3, [0.04] * 3, 0.3)), tmp_path / "scene")
    entries = set(json.loads((tmp_path / "scene" / "scene.json").read_text())["material"])
    assert entries == {"model", "diffuse_albedo", "specular_albedo", "roughness", "normal", "observed"}


def test_the_description_states_metalness_and_f0() -> None:
    summary = describe(asset_of(mixed()))
    assert summary["model"] == "metallic" and summary["metalness"] == "16 x 16" and summary["dielectric_f0"] == 0.06
    assert describe(asset_of(AssetMaterial.metallic([1, 1, 1], 0.5, 0.3)))["metalness"] == 0.5
    assert "metalness" not in describe(asset_of(AssetMaterial("dielectric", [0.5] * 3, [0.04] * 3, 0.3)))
