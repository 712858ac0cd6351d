"""A `metallic` asset in every format, valid for the formats' validators, and back within the 8 bits of their images."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.asset import Asset, AssetMaterial
from hir_exporters.conventions import linear_to_srgb
from hir_exporters.engines.engine_shaders import engine_psnr
from hir_exporters.format_options import GltfConfig, UsdConfig
from hir_exporters.formats import create_exporter
from hir_exporters.reading.asset_decoding import decode_material
from hir_exporters.reading.file_verification import read_back, verify_file
from hir_exporters.reading.mesh_import import load_mesh_asset
from hir_exporters.reading.validators import validate_gltf, validate_usd

MESH_FORMATS = ["glb", "gltf", "usda", "usdc", "usdz", "obj"]
MATERIALS = ["gold", "half", "mixed", "base texture", "roughness texture", "own F0"]


@pytest.fixture
def assets(textured_asset: Asset) -> dict[str, Asset]:
    """Constants, textures of each parameter, and a map of metal and plastic with soft edges."""
    rng = np.random.default_rng(0)
    texture = rng.random((16, 16, 3))
    metalness = np.clip(np.linspace(-1, 2, 16)[:, None] + np.zeros((16, 16)), 0, 1)
    alpha = rng.uniform(0.05, 0.9, (16, 16))
    normal, gold = textured_asset.material.normal, [0.9, 0.6, 0.2]
    materials = {
        "gold": AssetMaterial.metallic(gold, 1.0, 0.09),
        "half": AssetMaterial.metallic(gold, 0.5, 0.09),
        "mixed": AssetMaterial.metallic(texture, metalness, alpha, normal),
        "base texture": AssetMaterial.metallic(texture, 1.0, 0.2),
        "roughness texture": AssetMaterial.metallic(gold, 0.75, alpha),
        "own F0": AssetMaterial.metallic(texture, metalness, 0.2, dielectric_f0=0.1),
    }
    return {name: dataclasses.replace(textured_asset, material=value) for name, value in materials.items()}


@pytest.mark.parametrize("suffix", MESH_FORMATS)
@pytest.mark.parametrize("name", MATERIALS)
def test_the_material_comes_back(assets: dict[str, Asset], name: str, suffix: str, tmp_path: Path) -> None:
    asset = assets[name]
    wanted = asset.material
    create_exporter(suffix).write(asset, tmp_path / f"x.{suffix}")
    found = load_mesh_asset(tmp_path / f"x.{suffix}").material
    assert found.model == "metallic" and found.metalness is not None and wanted.metalness is not None
    np.testing.assert_allclose(found.metalness, wanted.metalness, atol=0.51 / 255)
    np.testing.assert_allclose(linear_to_srgb(found.base_color), linear_to_srgb(wanted.base_color), atol=0.6 / 255)
    np.testing.assert_allclose(np.sqrt(found.roughness), np.sqrt(wanted.roughness), atol=0.51 / 255)
    f0 = 0.04 if suffix == "obj" else wanted.dielectric_f0  # an .mtl's Ni is not read: many programs leave it at 1
    assert found.dielectric_f0 == pytest.approx(f0, abs=1e-6)
    assert (found.normal is None) == (wanted.normal is None)


@pytest.mark.parametrize("name", MATERIALS)
def test_files_are_valid_and_hold_the_parameters(
    assets: dict[str, Asset], name: str, node_tools: Path, tmp_path: Path
) -> None:
    asset = assets[name]
    gltf, usd = [], []
    for profile in ("khr", "blender", "metalrough", "unity-legacy"):
        gltf.append(tmp_path / f"{profile}.glb")
        report = create_exporter("glb", GltfConfig(profile=profile)).write(asset, gltf[-1])  # type: ignore[arg-type]
        if profile in ("khr", "blender") or (profile == "metalrough" and name != "own F0"):
            assert report.residuals[profile] < 1e-6 and report.warnings == ()
        check = verify_file(gltf[-1], asset, profile)
        assert check.problems == () and check.brdf == pytest.approx(report.residuals[profile], abs=0.01)
    for suffix in ("usda", "usdz"):
        report = create_exporter(suffix).write(asset, tmp_path / f"x.{suffix}")
        usd += [path for path in report.files if path.suffix.startswith(".usd")]
        assert report.residuals == {"usd-metallic": pytest.approx(0, abs=1e-6)}
        check = verify_file(tmp_path / f"x.{suffix}", asset)
        assert check.problems == () and check.brdf < 0.01
    usd += create_exporter("usda", UsdConfig(workflow="specular")).write(asset, tmp_path / "specular.usda").files[:1]
    assert [f for f in validate_gltf(gltf, node_tools) if f.severity != "information"] == []
    assert validate_usd(usd) == []


def test_core_gltf_needs_no_extension_and_another_f0_only_the_ior(assets: dict[str, Asset], tmp_path: Path) -> None:
    for name, extensions in (("mixed", None), ("own F0", ["KHR_materials_ior"])):
        create_exporter("gltf").write(assets[name], tmp_path / "x.gltf")
        document = json.loads((tmp_path / "x.gltf").read_text())
        assert document.get("extensionsUsed") == extensions
    core = document["materials"][0]["pbrMetallicRoughness"]
    assert core["metallicFactor"] == 1.0 and core["roughnessFactor"] == pytest.approx(0.2**0.5)
    assert "metallicRoughnessTexture" in core


def test_the_mtl_has_metalness_as_a_number_or_as_a_map(assets: dict[str, Asset], tmp_path: Path) -> None:
    for name, number, mapped in (("gold", 1.0, False), ("half", 0.5, False), ("mixed", 0.5, True)):
        create_exporter("obj").write(assets[name], tmp_path / name / "x.obj")
        text = (tmp_path / name / "x.mtl").read_text()
        [found] = re.findall(r"^Pm (\S+)$", text, re.MULTILINE)
        assert float(found) == pytest.approx(number, abs=0.01), "of a map its mean"
        assert (tmp_path / name / "x_obj_metallic.png").is_file() is mapped
        assert ("map_Pm x_obj_metallic.png" in text) is mapped


@pytest.mark.parametrize(("name", "least"), [("gold", 60.0), ("base texture", 45.0)])
def test_a_metal_looks_in_gltf_as_in_the_fit(assets: dict[str, Asset], name: str, least: float, tmp_path: Path) -> None:
    """For a metal the model and glTF's formula are one; what is left is the 8 bits of the base colour's image."""
    create_exporter("glb").write(assets[name], tmp_path / "x.glb")
    assert engine_psnr(assets[name], read_back(tmp_path / "x.glb").surface, None)["gltf"] > least


def test_a_file_without_metal_stays_a_dielectric(assets: dict[str, Asset], tmp_path: Path) -> None:
    plastic = dataclasses.replace(assets["gold"], material=AssetMaterial.metallic([0.9, 0.6, 0.2], 0.0, 0.09))
    create_exporter("glb").write(plastic, tmp_path / "x.glb")
    found = load_mesh_asset(tmp_path / "x.glb").material
    assert found.model == "dielectric" and found.metalness is None
    np.testing.assert_allclose(found.diffuse_albedo, [0.9, 0.6, 0.2], atol=1e-6)
    np.testing.assert_allclose(found.specular_albedo, 0.04, atol=1e-6)


def test_a_fit_of_another_model_is_decoded_as_that_model_looks(assets: dict[str, Asset], tmp_path: Path) -> None:
    """For metalness in between, `as_metallic=False` has the diffuse reflection of glTF's mix at normal incidence."""
    create_exporter("glb").write(assets["half"], tmp_path / "x.glb")
    back = read_back(tmp_path / "x.glb")
    found, _ = decode_material(back, "khr", as_metallic=False)
    assert found.model == "dielectric" and found.metalness is None
    np.testing.assert_allclose((1 - found.specular_albedo) * found.diffuse_albedo, 0.5 * 0.96 * back.surface.base_color)
    assert decode_material(back, "khr")[0].model == "metallic"
