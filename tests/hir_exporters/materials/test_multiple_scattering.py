"""Base colours of profile engine: the scaled lobe reflects what the model's lobe reflects."""

import numpy as np
import pytest
from hir_exporters.asset import AssetMaterial
from hir_exporters.materials.brdf_numpy import albedo_terms, ggx_distribution, integrate_albedo
from hir_exporters.materials.brdf_slice import VIEW_COSINES
from hir_exporters.materials.material_conversion import to_gltf
from hir_exporters.materials.multiple_scattering import engine_albedo, engine_base_color


@pytest.mark.parametrize("alpha", [0.01, 0.1, 0.3, 0.6, 1.0])
@pytest.mark.parametrize("color", [0.2, 0.5, 0.9])
def test_the_albedo_over_all_views_is_that_of_the_model(alpha: float, color: float) -> None:
    base = engine_base_color(to_gltf(AssetMaterial.metallic([color] * 3, 1.0, alpha), "khr")).base_color
    scale, bias = albedo_terms(VIEW_COSINES, alpha)
    engine = engine_albedo(VIEW_COSINES, np.asarray(alpha), float(base[0]))
    assert np.mean(engine) == pytest.approx(np.mean(color * scale + bias), rel=2e-3)


def test_rough_metals_change_most_and_mirrors_do_not() -> None:
    changed = [
        1 - float(to_gltf(AssetMaterial.metallic([0.9] * 3, 1.0, alpha), "engine").base_color[0]) / 0.9
        for alpha in (0.001, 0.1, 0.5, 1.0)
    ]
    assert changed == sorted(changed) and abs(changed[0]) < 0.002 and changed[-1] > 0.1


def test_a_dielectric_is_unaltered_and_half_a_metal_changes_half() -> None:
    plastic, half, metal = (
        to_gltf(AssetMaterial.metallic([0.8, 0.5, 0.2], m, 0.5), "engine").base_color for m in (0.0, 0.5, 1.0)
    )
    np.testing.assert_array_equal(plastic, np.float32([0.8, 0.5, 0.2]))
    np.testing.assert_allclose(half, (plastic + metal) / 2, atol=1e-6)


def test_textures_of_different_sizes_and_the_other_maps_are_kept() -> None:
    alpha = np.linspace(0.05, 0.9, 16, dtype=np.float32).reshape(4, 4)
    material = AssetMaterial.metallic(np.full((2, 2, 3), 0.7), np.ones((2, 2)), alpha)
    khr, engine = to_gltf(material, "khr"), to_gltf(material, "engine")
    assert engine.base_color.shape == (4, 4, 3)
    assert (np.diff(engine.base_color[..., 0].ravel()) < 0).all(), "rougher texels are darker"
    np.testing.assert_array_equal(engine.roughness, khr.roughness)
    np.testing.assert_array_equal(engine.metallic, khr.metallic)


def test_the_correlated_albedo_agrees_with_integration_over_directions() -> None:
    """Brute force over the hemisphere of light directions, with Heitz' G written out again."""
    alpha, cos_o, count = 0.5, 0.6, 800
    cos_i = (np.arange(count) + 0.5)[:, None] / count
    azimuth = 2 * np.pi * (np.arange(count) + 0.5)[None] / count
    sin_i, sin_o = np.sqrt(1 - cos_i**2), np.sqrt(1 - cos_o**2)
    length = np.sqrt(2 + 2 * (cos_i * cos_o + sin_i * sin_o * np.cos(azimuth)))

    def smith_lambda(cosine: np.ndarray) -> np.ndarray:
        return (np.sqrt(1 + alpha**2 * (1 / cosine**2 - 1)) - 1) / 2

    masking = 1 / (1 + smith_lambda(cos_i) + smith_lambda(np.asarray(cos_o)))
    lobe = ggx_distribution((cos_i + cos_o) / length, alpha) * masking / (4 * cos_i * cos_o)
    schlick = (1 - length / 2) ** 5
    scale, bias = (2 * np.pi * np.mean(lobe * cos_i * part) for part in (1 - schlick, schlick))
    found = integrate_albedo(cos_o, alpha, correlated=True)
    assert float(found[0]) == pytest.approx(scale, abs=1e-3) and float(found[1]) == pytest.approx(bias, abs=1e-3)
