"""Engines' formulas on points of the surface: they agree where they should and tell apart what engines confuse."""

import dataclasses

import numpy as np
import pytest
from hir_exporters.asset import Asset, AssetEnvironment, AssetMaterial
from hir_exporters.conventions import latlong_directions
from hir_exporters.engines.engine_shaders import GLTF_ENGINES, EngineComparison, MaterialSamples, engine_psnr
from hir_exporters.engines.surface_points import surface_points
from hir_exporters.materials.brdf_numpy import albedo_terms
from hir_exporters.materials.material_conversion import to_gltf, to_specular_workflow, to_usd_metallic
from hir_exporters.materials.surfaces import MetallicSurface, SpecularSurface


def under_sky(asset: Asset, material: AssetMaterial, even: bool = False) -> Asset:
    d = latlong_directions(32, 64)
    sky = np.full((32, 64, 3), 0.7) if even else 0.4 + 0.3 * d[..., 1:2] * [0.8, 1, 1.2] + 0.2 * d[..., :1]
    return dataclasses.replace(asset, material=material, environment=AssetEnvironment(sky))


def converted(material: AssetMaterial, profile: str) -> tuple[MetallicSurface, SpecularSurface | None]:
    found = to_gltf(material, profile)
    if isinstance(found, MetallicSurface):
        return found, None
    return to_gltf(material, "metalrough"), found


def test_what_is_exact_is_exact_and_the_wrong_profile_is_not(constant_asset: Asset) -> None:
    material = AssetMaterial("paper", [0.5, 0.4, 0.3], [0.2] * 3, 0.2)
    asset = under_sky(constant_asset, material)
    khr, blender = (engine_psnr(asset, *converted(material, p)) for p in ("khr", "blender"))
    assert khr["gltf"] > 80 and blender["blender"] > 80
    assert blender["gltf"] < 50 and khr["blender"] > 80, "the two agree where the colour is grey"


def test_metals_are_black_where_the_specular_workflow_is_passed_over(constant_asset: Asset) -> None:
    material = AssetMaterial("dielectric", [0.0] * 3, [0.9, 0.7, 0.4], 0.2)
    asset = under_sky(constant_asset, material)
    specular = to_specular_workflow(material)
    one = np.ones((), np.float32)
    as_metallic = MetallicSurface(specular.diffuse, 0 * one, specular.roughness, one, np.ones(3), 1.5, 0.0)
    found = engine_psnr(asset, as_metallic, specular, usd=True)
    assert found["usd"] > 80 > 20 > found["blender"]
    assert engine_psnr(asset, to_usd_metallic(material), None, usd=True)["blender"] > 80


def test_unreal_and_unity_lose_what_their_parameters_cannot_say(constant_asset: Asset) -> None:
    """A coloured non-metal of 0.15: Unreal has one grey of at most 0.08, Unity's core reading 0.04."""
    colored = AssetMaterial("dielectric", [0.3] * 3, [0.15, 0.08, 0.04], 0.1)
    plain = AssetMaterial("dielectric", [0.3] * 3, [0.04] * 3, 0.1)
    psnr_colored, psnr_plain = (
        engine_psnr(under_sky(constant_asset, m), *converted(m, "khr")) for m in (colored, plain)
    )
    for engine in ("unreal", "unity"):
        assert psnr_colored[engine] < psnr_plain[engine], engine
    specular_glossiness = engine_psnr(under_sky(constant_asset, colored), *converted(colored, "unity-legacy"))
    assert specular_glossiness["unity"] > psnr_colored["unity"]


@pytest.mark.parametrize("alpha", [0.05, 0.3, 0.9])
def test_white_metal_in_an_even_light(constant_asset: Asset, alpha: float) -> None:
    """three.js gives back the light that bounces inside the lobe: a white metal is as bright as its surroundings."""
    material = AssetMaterial("dielectric", [0.0] * 3, [1.0] * 3, alpha)
    asset = under_sky(constant_asset, material, even=True)
    points = surface_points(asset)
    texels = MaterialSamples(points, *converted(material, "khr"))
    np.testing.assert_allclose(GLTF_ENGINES["three.js"](points, texels).mean(), 0.7, rtol=0.01)
    lost = sum(albedo_terms(points.cos_o, points.alpha))
    np.testing.assert_allclose(GLTF_ENGINES["gltf"](points, texels).mean() / 0.7, lost.mean(), rtol=0.01)


def test_points_measure_the_light_and_see_the_front(textured_asset: Asset) -> None:
    points = surface_points(under_sky(textured_asset, textured_asset.material, even=True))
    assert len(points.uvs) > 800 and points.cos_o.min() > 0
    np.testing.assert_allclose(points.irradiance_over_pi(), 0.7, rtol=0.02)
    np.testing.assert_allclose(points.prefiltered(points.normals, points.alpha), 0.7, rtol=1e-6)
    a, b = points.lobe_terms()
    assert (a + b <= 1.02).all() and (a >= 0).all() and (b >= 0).all()


def test_the_same_numbers_every_time(textured_asset: Asset) -> None:
    surface, _ = converted(textured_asset.material, "khr")
    assert engine_psnr(textured_asset, surface, None) == engine_psnr(textured_asset, surface, None)


def test_files_that_share_a_comparison_get_the_same_figures(textured_asset: Asset) -> None:
    comparison = EngineComparison(textured_asset)
    for profile, usd in (("khr", False), ("metalrough", True), ("khr", False)):
        surfaces = converted(textured_asset.material, profile)
        assert comparison.psnr(*surfaces, usd=usd) == engine_psnr(textured_asset, *surfaces, usd=usd)
