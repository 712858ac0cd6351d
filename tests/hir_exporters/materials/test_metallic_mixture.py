"""`dielectric` texels that are neither plastic nor metal: glTF's mixture of both must reflect what they reflect."""

import dataclasses

import numpy as np
import pytest
from hir_exporters.asset import AssetMaterial
from hir_exporters.materials import material_conversion
from hir_exporters.materials.surfaces import MetallicSurface
from hir_exporters.materials.target_brdfs import CORE_F0
from hir_exporters.textures.texture_maps import sample_texels

GREYS = [(0.2, 0.2, 0.2), (0.1, 0.3, 0.3), (0.05, 0.5, 0.15), (0.6, 0.18, 0.5), (0.3, 0.4, 1.0)]
"""Diffuse, specular and alpha of mixtures in which no channel has to be cut."""


def reflected(surface: MetallicSurface) -> tuple[np.ndarray, np.ndarray]:
    """At normal incidence by glTF's text: from the lobe, and from below through what the lobe leaves."""
    m = np.asarray(surface.metallic, np.float64)[..., None]
    f0 = np.minimum(CORE_F0 * surface.specular_color.astype(np.float64), 1)
    base = surface.base_color.astype(np.float64)
    return (1 - m) * f0 + m * base, (1 - m) * base * (1 - f0)


@pytest.mark.parametrize(("diffuse", "specular", "alpha"), GREYS)
def test_a_mixture_reflects_the_model_at_normal_incidence(diffuse: float, specular: float, alpha: float) -> None:
    material = AssetMaterial("dielectric", [diffuse] * 3, [specular] * 3, alpha)
    surface = material_conversion._mixture(material)
    assert 0 < float(surface.metallic) < 1 and surface.base_color.max() < 1
    lobe, below = reflected(surface)
    np.testing.assert_allclose(lobe, specular, rtol=1e-5)
    np.testing.assert_allclose(below, diffuse * (1 - specular), rtol=1e-5)


def test_a_map_of_plastic_metal_and_both_keeps_each_texel() -> None:
    """Plastic keeps its albedo and F0 as they are, metal its colour, and the mixture reflects as it should."""
    plastic, mixed, metal = ([0.4, 0.2, 0.1], [0.08, 0.05, 0.04]), ([0.2] * 3, [0.2] * 3), ([0.0] * 3, [0.9, 0.7, 0.3])
    diffuse, specular = (np.repeat(np.float32([[t[k] for t in (plastic, mixed, metal)]]), 6, axis=0) for k in (0, 1))
    surface = material_conversion.to_gltf(AssetMaterial("dielectric", diffuse, specular, 0.2), "khr")
    lobe, below = reflected(surface)
    assert surface.metallic.shape == (6, 3)
    np.testing.assert_allclose(surface.metallic[:, [0, 2]], np.repeat([[0.0, 1.0]], 6, axis=0))
    np.testing.assert_array_equal(surface.base_color[:, 0], diffuse[:, 0])
    np.testing.assert_allclose(surface.base_color[:, 2], specular[:, 2], atol=1e-6)
    np.testing.assert_allclose(surface.specular_color[:, 0] * CORE_F0, specular[:, 0], rtol=1e-6)
    np.testing.assert_array_equal(surface.specular_color[:, 2], 1)
    np.testing.assert_allclose(lobe, specular, atol=1e-6)
    np.testing.assert_allclose(below, diffuse * (1 - specular), atol=1e-6)
    assert surface.metallic.dtype == surface.base_color.dtype == surface.specular_color.dtype == np.float32
    assert surface.residual < 0.02


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_one_channel_above_plastic_makes_a_texel_a_candidate_for_metal(channel: int) -> None:
    """A limit's two sides, in each channel: what a non-metal may reflect is never a mixture."""
    specular = np.full((2, 8, 3), 0.1, np.float32)
    specular[:, 4:, channel] = 0.9
    specular[0, :4, channel] = material_conversion.METAL_F0
    material = AssetMaterial("dielectric", np.zeros_like(specular), specular, 0.3)
    np.testing.assert_array_equal(
        material_conversion._mixture(material).metallic, np.repeat([[0.0, 1.0]], [4, 4], axis=1).repeat(2, 0)
    )


def test_where_the_core_is_nearer_it_is_taken() -> None:
    """A specular colour that no metal has: the mixture's normal incidence costs more elsewhere."""
    far = AssetMaterial("dielectric", [0.3, 0.2, 0.1], [0.3, 0.25, 0.2], 0.3)
    near = AssetMaterial("dielectric", [0.2] * 3, [0.2] * 3, 0.2)
    assert material_conversion.to_gltf(far, "khr") == _alike(material_conversion.to_gltf(far, "metalrough"))
    assert (
        material_conversion.to_gltf(near, "khr").residual
        < 0.6 * material_conversion.to_gltf(near, "metalrough").residual
    )


def test_bright_mixtures_stay_within_what_falls_on_them() -> None:
    """White paint under a half mirror has no colour that would do: it is cut, not negative or above one."""
    for diffuse, specular in [(1.0, 0.5), (1.0, [0.9, 0.2, 0.02]), (0.5, [1.0, 0.0, 0.5])]:
        albedos = np.broadcast_to(np.float32(diffuse), (4, 4, 3)).copy(), np.empty((4, 4, 3), np.float32)
        albedos[1][:] = specular
        albedos[1][0] = 0.05  # a map, that no constant takes its place
        surface = material_conversion._mixture(AssetMaterial("dielectric", *albedos, 0.3))
        assert surface.base_color.min() >= 0 and surface.base_color.max() <= 1
        assert surface.specular_color.min() >= 0 and CORE_F0 * surface.specular_color.max() <= 1 + 1e-6
        lobe, _ = reflected(surface)
        assert np.abs(lobe[0] - 0.05).max() < 1e-6


def test_widths_as_a_map_are_fitted_texel_by_texel() -> None:
    """A constant colour and a map of alpha: each texel is what its own width gives."""
    alpha = np.float32([[0.1, 0.5], [0.1, 0.5]])
    material = AssetMaterial("dielectric", [0.0, 0.02, 0.0], [0.9, 0.7, 0.3], alpha)
    whole = material_conversion._mixture(material)
    for column, width in enumerate((0.1, 0.5)):
        alone = material_conversion._mixture(dataclasses.replace(material, roughness=np.float32(width)))
        np.testing.assert_allclose(_at(whole.base_color, column), alone.base_color, atol=1e-5)
        np.testing.assert_allclose(_at(whole.metallic, column), alone.metallic, atol=1e-6)


def _at(value: np.ndarray, column: int) -> np.ndarray:
    place = np.array([[(column + 0.5) / 2, 0.25]])
    return sample_texels(value, value.ndim in (1, 3), place)[0]


class _alike:  # reads as a word in a comparison  # noqa: N801 - reads as a word in a comparison
    """Equal to a surface of the same numbers; arrays have no equality of their own."""

    def __init__(self, surface: MetallicSurface) -> None:
        self.surface = surface

    def __eq__(self, other: object) -> bool:
        pairs = zip(*(map(np.asarray, dataclasses.astuple(s)[:7]) for s in (self.surface, other)), strict=True)
        return all(np.array_equal(a, b) for a, b in pairs)
