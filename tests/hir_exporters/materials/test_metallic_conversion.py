"""`metallic` in numpy, and in the terms of each format: written as it is, without a fit."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hir_exporters.asset import AssetMaterial
from hir_exporters.materials import material_conversion
from hir_exporters.materials.brdf_numpy import (
    dielectric_brdf,
    directional_albedo,
    ggx_distribution,
    half_vector_cosines,
    metallic_brdf,
    schlick_weight,
    smith_visibility,
)
from hir_exporters.materials.surfaces import MetallicSurface, SpecularSurface
from hir_exporters.materials.target_brdfs import ior_to_f0
from hir_exporters.materials.texture_packing import limit_texture_sizes

METALLIC_ROUGHNESS = ["khr", "blender", "metalrough", "usd-metallic"]


def directions(count: int, seed: int) -> np.ndarray:
    """Unit vectors of the upper hemisphere."""
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    vectors[:, 2] = np.abs(vectors[:, 2])
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def converted(material: AssetMaterial, profile: str) -> MetallicSurface:
    if profile == "usd-metallic":
        return material_conversion.to_usd_metallic(material)
    surface = material_conversion.to_gltf(material, profile)  # type: ignore[arg-type]
    assert isinstance(surface, MetallicSurface)
    return surface


@pytest.mark.parametrize("m", [0.0, 0.5, 1.0])
def test_brdf_is_the_closing_formula_of_the_specification(m: float) -> None:
    """glTF 2.0, B.3.5: F = f0 + (1 − f0)(1 − |v·h|)⁵, f = (1 − F) c_diff/π + F·D·V; 1 − F averaged over the lobe."""
    wi, wo = directions(300, 3), directions(300, 4)
    base, alpha = np.random.default_rng(5).random((300, 3)), 0.2
    cos_i, cos_o, cos_h, cos_d = half_vector_cosines(wi, wo)
    c_diff, f0 = base * (1 - m), 0.04 * (1 - m) + base * m
    fresnel = f0 + (1 - f0) * schlick_weight(cos_d)[:, None]
    lobe = ggx_distribution(cos_h, alpha) * smith_visibility(cos_i, cos_o, alpha)
    coupled = 1 - directional_albedo(cos_o[:, None], alpha, f0)
    expected = coupled * c_diff / np.pi + fresnel * lobe[:, None]
    np.testing.assert_allclose(metallic_brdf(wi, wo, base, np.full(300, m), alpha), expected, rtol=1e-12)


def test_ends_are_a_dielectric_and_a_reciprocal_metal() -> None:
    wi, wo = directions(300, 6), directions(300, 7)
    base = np.random.default_rng(8).random((300, 3))
    np.testing.assert_array_equal(
        metallic_brdf(wi, wo, base, np.zeros(300), 0.3, 0.07), dielectric_brdf(wi, wo, base, [0.07] * 3, 0.3)
    )
    there, back = (metallic_brdf(a, b, base, np.ones(300), 0.3) for a, b in ((wi, wo), (wo, wi)))
    np.testing.assert_allclose(there, back, rtol=1e-12)


@pytest.mark.parametrize("m", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("alpha", [0.1, 0.4, 1.0])
def test_reflects_no_more_than_it_receives(m: float, alpha: float) -> None:
    """The integral of f cos over the hemisphere of lights, for a white base colour: 1 without metal, else below 1."""
    n = 400
    mu, phi = np.meshgrid((np.arange(n) + 0.5) / n, (np.arange(2 * n) + 0.5) * np.pi / n, indexing="ij")
    sin = np.sqrt(1 - mu * mu)
    wi = np.stack([sin * np.cos(phi), sin * np.sin(phi), mu], -1).reshape(-1, 3)
    for cos_o in (0.2, 0.7, 1.0):
        wo = np.array([math.sqrt(1 - cos_o**2), 0.0, cos_o])
        f = metallic_brdf(wi, np.broadcast_to(wo, wi.shape), np.ones(3), np.full(len(wi), m), alpha)
        total = float((f[:, 0] * wi[:, 2]).mean() * 2 * np.pi)
        assert total < 1 + 3e-3
        if m == 0:
            assert total == pytest.approx(1, abs=3e-3)


def test_extreme_values_stay_finite() -> None:
    wi = np.array([[0, 0, 1], [1, 0, 0], [1, 0, 1e-9], [0.6, 0, -0.8], [0.6, 0, 0.8]])
    for m in (0.0, 0.5, 1.0):
        for base in (0.0, 1.0):
            for alpha in (0.0, 1e-4, 1.0):
                for f0 in (0.0, 0.5):
                    f = metallic_brdf(wi[:, None], wi[None], [base] * 3, m, alpha, f0)
                    assert np.isfinite(f).all() and (f >= 0).all()


@pytest.mark.parametrize("profile", METALLIC_ROUGHNESS)
@pytest.mark.parametrize("f0", [0.04, 0.08, 0.0])
@pytest.mark.parametrize("textured", [False, True])
def test_metallic_roughness_gets_the_parameters_themselves(profile: str, f0: float, textured: bool) -> None:
    rng = np.random.default_rng(9)
    shape = (8, 8) if textured else ()
    base, m, alpha = rng.random((*shape, 3)), np.asarray(rng.random(shape)), rng.uniform(0.01, 1, shape)
    if textured:
        m[:3], m[3:6] = 0, 1
    surface = converted(AssetMaterial.metallic(base, m, alpha, dielectric_f0=f0), profile)
    np.testing.assert_allclose(surface.base_color, base, atol=3e-7)
    np.testing.assert_array_equal(surface.metallic, m.astype(np.float32))
    np.testing.assert_allclose(surface.roughness, np.sqrt(alpha), rtol=1e-6)
    assert surface.specular_weight.tolist() == 1 and surface.specular_color.tolist() == [1, 1, 1]
    if f0 == 0.04 or profile == "metalrough":
        assert surface.ior == 1.5
    else:
        assert ior_to_f0(surface.ior) == pytest.approx(f0, abs=1e-12)
    if f0 != 0.04 and profile == "metalrough":
        assert surface.residual > 1e-3, "the core has no F0 of its own"
    else:
        assert surface.residual < 1e-6


def test_specular_workflow_gets_the_albedos() -> None:
    material = AssetMaterial.metallic([0.9, 0.6, 0.2], 0.25, 0.3)
    surface = material_conversion.to_gltf(material, "unity-legacy")
    assert isinstance(surface, SpecularSurface)
    np.testing.assert_array_equal(surface.diffuse, material.diffuse_albedo)
    np.testing.assert_array_equal(surface.specular, material.specular_albedo)


def test_smaller_textures_are_averages_of_the_parameters() -> None:
    """A texel half of gold, half of blue plastic: the average of its albedos would be of no base colour."""
    base = np.zeros((2, 2, 3), np.float32)
    base[:, 0], base[:, 1] = [1.0, 0.7, 0.2], [0.1, 0.1, 0.9]
    material = AssetMaterial.metallic(base, [[1, 0], [1, 0]], [[0.1, 0.3], [0.1, 0.3]], dielectric_f0=0.05)
    small = limit_texture_sizes(material, 1)
    np.testing.assert_allclose(small.base_color, [[[0.55, 0.4, 0.55]]], atol=1e-6)
    assert small.metalness is not None and small.metalness.tolist() == [[0.5]] and small.dielectric_f0 == 0.05
    np.testing.assert_allclose(small.roughness, 0.2, rtol=1e-6)
