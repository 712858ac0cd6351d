"""Budgets in bytes: the file is within them, the report says what was reduced, and the file still reads back."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hir_exporters import budgets
from hir_exporters.asset import Asset, AssetMaterial, AssetMesh
from hir_exporters.budgets import Budget
from hir_exporters.errors import ExportError
from hir_exporters.format_options import GltfConfig, UsdConfig, UsdzConfig
from hir_exporters.formats import create_exporter
from hir_exporters.reading.file_verification import verify_file
from hir_exporters.reading.gltf_readback import read_gltf
from hir_exporters.reading.usd_reading.usd_readback import read_usd
from hir_exporters.reading.validators import validate_gltf
from hir_exporters.textures.image_encoding import ImageEncoding, encode_within

Sphere = Callable[..., AssetMesh]


def document(path: Path) -> dict:
    data = path.read_bytes()
    return json.loads(data[20 : 20 + struct.unpack("<I", data[12:16])[0]])


@pytest.fixture
def heavy(textured_asset: Asset) -> Asset:
    """Noise in every map, which lossless files cannot compress: 0.6 MB as PNG."""
    noise = np.random.default_rng(0).random((256, 256, 3)).astype(np.float32)
    tilted = np.concatenate([0.3 * (noise[..., :2] - 0.5), np.ones((256, 256, 1), np.float32)], -1)
    material = AssetMaterial.metallic(
        0.1 + 0.8 * noise,
        (noise[..., 0] > 0.5).astype(np.float32),
        0.1 + 0.5 * noise[..., 1],
        tilted / np.linalg.norm(tilted, axis=-1, keepdims=True),
    )
    return replace(textured_asset, material=material)


@pytest.mark.parametrize("limit", [400_000, 120_000])
@pytest.mark.parametrize("suffix", ["glb", "usdz"])
def test_a_file_is_within_its_budget(
    limit: int, suffix: str, heavy: Asset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(budgets.BUDGETS, "web", Budget(100_000, 2048, limit))
    sizes = {}
    for name in ("none", "web"):
        config = GltfConfig(budget=name) if suffix == "glb" else UsdzConfig(budget=name)
        report = create_exporter(suffix, config).write(heavy, tmp_path / f"{name}.{suffix}")
        sizes[name] = (tmp_path / f"{name}.{suffix}").stat().st_size
    assert sizes["web"] <= limit < sizes["none"]
    assert any("JPEG" in warning and "web budget" in warning for warning in report.warnings)
    back = read_gltf(tmp_path / "web.glb") if suffix == "glb" else read_usd(tmp_path / "web.usdz")
    assert back.corner_positions.shape == (len(heavy.mesh.faces), 3, 3) and back.normal is not None


def test_a_mesh_that_takes_more_than_half_is_simplified(
    heavy: Asset, make_sphere: Sphere, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(budgets.BUDGETS, "phone", Budget(100_000, 2048, 150_000))
    fine = replace(heavy, mesh=make_sphere(60, 120))
    report = create_exporter("glb", GltfConfig(budget="phone")).write(fine, tmp_path / "x.glb")
    assert (tmp_path / "x.glb").stat().st_size <= 150_000
    assert any("triangles were reduced from" in warning and "phone" in warning for warning in report.warnings)


def test_what_fits_is_not_touched(heavy: Asset, tmp_path: Path) -> None:
    alone = create_exporter("glb").write(heavy, tmp_path / "a.glb")
    report = create_exporter("glb", GltfConfig(budget="web")).write(heavy, tmp_path / "b.glb")
    assert alone.files[0].read_bytes() == report.files[0].read_bytes() and report.warnings == ()


def test_a_budget_that_nothing_fits_is_refused() -> None:
    with pytest.raises(ExportError, match="larger than the 10 bytes left"):
        encode_within({"base_color": np.zeros((256, 256, 3), np.uint8)}, 10, ImageEncoding())


def test_webp_beside_a_fallback(heavy: Asset, node_tools: Path, tmp_path: Path) -> None:
    """Readers with the extension get the material as from PNG, others a small image. The validator has no finding."""
    path = tmp_path / "x.glb"
    create_exporter("glb", GltfConfig(image_format="webp", jpeg_quality=95)).write(heavy, path)
    content = document(path)
    assert "EXT_texture_webp" in content["extensionsUsed"] and "extensionsRequired" not in content
    for texture in content["textures"]:
        webp, fallback = texture["extensions"]["EXT_texture_webp"]["source"], texture["source"]
        assert content["images"][webp]["mimeType"] == "image/webp"
        assert content["images"][fallback]["mimeType"] in ("image/png", "image/jpeg")
    assert [f for f in validate_gltf([path], node_tools) if f.severity in ("error", "warning")] == []
    np.testing.assert_array_equal(  # lossless, so that channels do not blur into each other
        np.rint(read_gltf(path).surface.metallic), np.rint(np.broadcast_to(heavy.material.metalness, (256, 256)))
    )
    assert verify_file(path, heavy).problems == ()


def test_maps_of_one_value_are_no_images(textured_asset: Asset, tmp_path: Path) -> None:
    """Values within one 8-bit code of each other and flat normals: factors, and no tangents."""
    almost = 1e-4 * np.random.default_rng(0).random((64, 64)).astype(np.float32)
    flat = np.broadcast_to(np.array([0, 0, 1], np.float32), (64, 64, 3))
    material = AssetMaterial("dielectric", 0.5 + almost[..., None] * np.ones(3), [0.04] * 3, 0.25 + almost, flat)
    asset = replace(textured_asset, material=material)
    create_exporter("glb").write(asset, tmp_path / "x.glb")
    content = document(tmp_path / "x.glb")
    assert "images" not in content and "TANGENT" not in content["meshes"][0]["primitives"][0]["attributes"]
    report = create_exporter("usda", UsdConfig()).write(asset, tmp_path / "x.usda")
    create_exporter("obj").write(asset, tmp_path / "x.obj")
    assert not list(tmp_path.glob("*.png")) and report.files[0].is_file()
    for name in ("x.glb", "x.usda"):
        checked = verify_file(tmp_path / name, asset)
        assert checked.problems == () and checked.brdf < 0.03


def test_levels_of_detail_weigh_less(textured_asset: Asset, make_sphere: Sphere, tmp_path: Path) -> None:
    """Textures of half the size a level, or the finest level's in one file; that has one mesh for readers without."""
    fine = np.random.default_rng(0).random((1024, 1024, 3)).astype(np.float32)
    material = AssetMaterial("dielectric", 0.1 + 0.8 * fine, [0.04] * 3, 0.3)
    asset = replace(textured_asset, mesh=make_sphere(30, 60), material=material)
    create_exporter("glb", GltfConfig(lods=(800, 300))).write(asset, tmp_path / "x.glb")
    sizes = [read_gltf(tmp_path / f"x{level}.glb").surface.base_color.shape[0] for level in ("", "_lod1", "_lod2")]
    assert sizes == [1024, 512, 256]
    weights = [(tmp_path / f"x{level}.glb").stat().st_size for level in ("", "_lod1", "_lod2")]
    assert weights[1] < weights[0] / 2 and weights[2] < weights[1] / 2
    config = GltfConfig(lods=(800, 300), lod_layout="msft_lod", lod_normals=False)
    report = create_exporter("glb", config).write(asset, tmp_path / "one.glb")
    assert [file.name for file in report.files] == ["one.glb", "one.hdr"]
    content = document(tmp_path / "one.glb")
    node = content["nodes"][0]
    assert node["extensions"]["MSFT_lod"] == {"ids": [1, 2]} and content["scenes"][0]["nodes"] == [0]
    coverage = node["extras"]["MSFT_screencoverage"]
    assert len(coverage) == 3 and coverage[0] > coverage[1] > coverage[2] == 0
    assert len(content["images"]) == 1 and len(content["meshes"]) == len(content["materials"]) == 3
    counts = [content["accessors"][m["primitives"][0]["indices"]]["count"] // 3 for m in content["meshes"]]
    assert counts[0] == len(asset.mesh.faces) and counts[1] <= 800 and counts[2] <= 300
    assert len(read_gltf(tmp_path / "one.glb").corner_positions) == counts[0]
