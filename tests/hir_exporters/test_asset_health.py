"""The health of an asset: known assets have known figures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hir_exporters.asset import Asset, AssetEnvironment, AssetMaterial
from hir_exporters.asset_health import asset_health
from hir_exporters.conventions import latlong_directions


def lit_from_above(asset: Asset, frame: str = "world") -> Asset:
    """White light that is brightest at +Y."""
    light = (0.2 + np.maximum(latlong_directions(32, 64)[..., 1:2], 0) * np.ones(3)).astype(np.float32)
    return replace(asset, environment=AssetEnvironment(light, frame=frame))  # type: ignore[arg-type]


def test_shading_in_the_albedo_is_measured(textured_asset: Asset) -> None:
    """An albedo that is bright where the light is correlates; one that varies about the other axis does not.

    On the sphere of the fixture, v runs from +Y to -Y and u around it.
    """
    v, u = np.meshgrid((np.arange(64) + 0.5) / 64, (np.arange(64) + 0.5) / 64, indexing="ij")
    shaded = 0.3 + 0.2 * np.cos(np.pi * v)
    painted = 0.3 + 0.2 * np.cos(2 * np.pi * u)
    found = []
    for albedo in (shaded, painted, 0.8 - shaded):
        material = replace(textured_asset.material, diffuse_albedo=(albedo[..., None] * np.ones(3)).astype(np.float32))
        found.append(asset_health(lit_from_above(replace(textured_asset, material=material))).shading_correlation)
    assert found[0] is not None and found[0] > 0.9
    assert found[1] == pytest.approx(0, abs=0.05)
    assert found[2] is not None and found[2] < -0.9


def test_nothing_to_correlate(constant_asset: Asset, textured_asset: Asset) -> None:
    assert asset_health(lit_from_above(constant_asset)).shading_correlation is None
    even = replace(textured_asset, environment=AssetEnvironment(np.ones((8, 16, 3))))
    assert asset_health(even).shading_correlation is None
    assert asset_health(constant_asset).shading_correlation is None


def test_shares_and_flags(textured_asset: Asset) -> None:
    half = np.broadcast_to(np.arange(32)[:, None] < 16, (32, 32))
    material = AssetMaterial.metallic([0.5] * 3, half.astype(np.float32), np.full((32, 32), 0.2), observed=half)
    health = asset_health(lit_from_above(replace(textured_asset, material=material), "camera"))
    assert health.constant_roughness and health.light_moves_with_camera
    assert health.metal_share == pytest.approx(0.5, abs=0.02)
    assert health.unobserved_share == pytest.approx(0.5, abs=0.02)
    sentence = health.sentence()
    for words in ("one roughness", "50% metal", "observed by too few photographs", "the light moves with the camera"):
        assert words in sentence
    assert health.as_document()["metal_share"] == pytest.approx(health.metal_share, abs=1e-3)
    plastic = asset_health(textured_asset)
    assert not plastic.constant_roughness and plastic.metal_share is None and "no metalness" in plastic.sentence()


def test_texels_that_no_triangle_uses_are_no_plastic(textured_asset: Asset) -> None:
    corner = np.zeros((64, 64), np.float32)
    corner[:32, :32] = 1.0
    material = AssetMaterial.metallic([0.5] * 3, corner, [0.2])
    mesh = replace(textured_asset.mesh, uvs=0.45 * textured_asset.mesh.uvs)
    assert asset_health(replace(textured_asset, mesh=mesh, material=material)).metal_share == pytest.approx(1.0)
