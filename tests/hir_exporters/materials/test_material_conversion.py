import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from hir_exporters.asset import AssetMaterial
from hir_exporters.materials import brdf_numpy, brdf_slice, material_conversion
from hir_exporters.materials import target_brdfs as engine_models
from hir_exporters.materials.surfaces import MetallicSurface, SpecularSurface

Texture = Callable[..., np.ndarray]

GREY_PAPER = AssetMaterial("paper", [0.5, 0.4, 0.3], [0.2] * 3, 0.25)
COLOR_PAPER = AssetMaterial("paper", [0.3, 0.2, 0.1], [0.5, 0.3, 0.2], 0.1)
PLASTIC = AssetMaterial("dielectric", [0.5, 0.4, 0.3], [0.04] * 3, 0.25)
COATED = AssetMaterial("dielectric", [0.5, 0.4, 0.3], [0.07, 0.06, 0.05], 0.25)
GOLD = AssetMaterial("dielectric", [0.0] * 3, [0.9, 0.7, 0.3], 0.2)


def test_slice_agrees_with_the_models_themselves() -> None:
    alpha = np.array([0.05, 0.4])
    tested = brdf_slice.brdf_slice(alpha)
    # Directions rebuilt from the lobe and the Schlick term are not needed: an energy check fixes the weights instead.
    for t in range(2):
        for o, cos_o in enumerate(brdf_slice.VIEW_COSINES):
            lobe = (tested.lobe * tested.weight)[t, o].mean()
            np.testing.assert_allclose(lobe, sum(brdf_numpy.albedo_terms(cos_o, alpha[t])), atol=0.03)
            np.testing.assert_allclose(tested.weight[t, o].mean() / np.pi, 1.0, atol=0.05)


def test_paper_model_is_exact_by_the_ratified_text_for_grey_specular() -> None:
    surface = material_conversion.to_gltf(GREY_PAPER, "khr")
    assert surface.residual < 1e-6
    assert surface.ior == 1000 and surface.ior != 0
    np.testing.assert_allclose(surface.specular_weight, 0.2)
    np.testing.assert_allclose(surface.specular_color, 1.00401, atol=1e-5)
    np.testing.assert_allclose(surface.base_color, np.array([0.5, 0.4, 0.3]) / 0.8, rtol=1e-6)


def test_colored_paper_specular_is_exact_in_blender_and_near_by_the_text() -> None:
    for_blender = material_conversion.to_gltf(COLOR_PAPER, "blender")
    assert for_blender.residual < 1e-6 and for_blender.ior == material_conversion.NO_FRESNEL_IOR
    np.testing.assert_array_equal(for_blender.specular_color, COLOR_PAPER.specular_albedo)
    assert 0.01 < material_conversion.to_gltf(COLOR_PAPER, "khr").residual < 0.05


def test_glass_like_dielectric_needs_no_extension() -> None:
    for profile in ("khr", "blender", "metalrough"):
        surface = material_conversion.to_gltf(PLASTIC, profile)
        assert (surface.ior, float(surface.metallic), float(surface.specular_weight)) == (1.5, 0.0, 1.0)
        np.testing.assert_array_equal(surface.specular_color, 1)
        np.testing.assert_array_equal(surface.base_color, PLASTIC.diffuse_albedo)
        assert surface.residual < 0.03  # 1 - E against 1 - F: the diffuse part's share


def test_dielectric_lobe_is_exact_with_extensions() -> None:
    surface = material_conversion.to_gltf(COATED, "khr")
    np.testing.assert_allclose(surface.specular_color * 0.04, COATED.specular_albedo, rtol=1e-6)
    tested = brdf_slice.brdf_slice([0.25])
    black = np.zeros((1, 3))
    written = engine_models.gltf_brdf(
        tested, black, np.zeros(1), np.ones(1), surface.specular_color[None].astype(float), surface.ior
    )
    wanted = brdf_slice.model_brdf(tested, "dielectric", black, COATED.specular_albedo[None].astype(float))
    np.testing.assert_allclose(written, wanted, rtol=1e-6)
    assert surface.residual < material_conversion.to_gltf(COATED, "metalrough").residual


@pytest.mark.parametrize("profile", ["khr", "blender", "metalrough"])
def test_metal_is_metal_in_every_profile(profile: str) -> None:
    surface = material_conversion.to_gltf(GOLD, profile)
    assert float(surface.metallic) == 1.0 and surface.residual < 1e-6
    np.testing.assert_allclose(surface.base_color, [0.9, 0.7, 0.3], atol=1e-6)


def test_metalness_is_a_map_where_only_a_part_is_metal() -> None:
    specular = np.full((16, 16, 3), 0.04, np.float32)
    diffuse = np.full((16, 16, 3), 0.4, np.float32)
    specular[:, 8:], diffuse[:, 8:] = [0.9, 0.7, 0.3], 0.0
    surface = material_conversion.to_gltf(AssetMaterial("dielectric", diffuse, specular, 0.3), "khr")
    np.testing.assert_array_equal(surface.metallic[:, :8], 0)
    np.testing.assert_array_equal(surface.metallic[:, 8:], 1)
    assert surface.residual < 0.03


@pytest.mark.parametrize("material", [GREY_PAPER, COLOR_PAPER, COATED])
def test_metal_rough_fit_is_the_least_squares_optimum(material: AssetMaterial) -> None:
    """No nearby base colour, metalness or both has a smaller error on the slice."""
    surface = material_conversion.to_gltf(material, "metalrough")
    tested = brdf_slice.brdf_slice([float(material.roughness)])
    wanted = brdf_slice.model_brdf(
        tested,
        material.model,
        material.diffuse_albedo[None].astype(float),
        material.specular_albedo[None].astype(float),
    )

    def error(base: np.ndarray, metallic: float) -> float:
        one = np.ones(1)
        written = engine_models.gltf_brdf(tested, base[None], metallic * one, one, np.ones((1, 3)), 1.5)
        return brdf_slice.relative_error(tested, written, wanted)

    base, metallic = surface.base_color.astype(float), float(surface.metallic)
    best = error(base, metallic)
    assert best == pytest.approx(surface.residual, rel=1e-5)
    for channel in range(3):
        for step in (-0.02, 0.02):
            moved = base.copy()
            moved[channel] += step
            assert error(moved, metallic) > best
    rng = np.random.default_rng(0)
    for _ in range(300):  # 0.05 is the grid of the search over metalness
        m = float(np.clip(metallic + rng.choice([-0.1, -0.05, 0.05, 0.1]), 0, 1))
        if m != metallic:
            assert error(np.clip(base + rng.normal(0, 0.05, 3), 0, 1), m) > best * 0.999


def test_specular_workflow_fit_is_the_least_squares_optimum() -> None:
    surface = material_conversion.to_specular_workflow(GREY_PAPER)
    tested = brdf_slice.brdf_slice([0.25])
    wanted = brdf_slice.model_brdf(tested, "paper", np.array([[0.5, 0.4, 0.3]]), np.full((1, 3), 0.2))
    diffuse, specular = surface.diffuse.astype(float), surface.specular.astype(float)
    for d, s in [(0.01, 0), (-0.01, 0), (0, 0.01), (0, -0.01)]:
        moved = engine_models.specular_workflow_brdf(tested, diffuse[None] + d, specular[None] + s)
        assert brdf_slice.relative_error(tested, moved, wanted) > surface.residual
    assert surface.residual < material_conversion.to_gltf(GREY_PAPER, "metalrough").residual * 1.02


def test_usd_metallic_uses_the_ior_of_a_grey_dielectric() -> None:
    surface = material_conversion.to_usd_metallic(dataclasses.replace(PLASTIC, specular_albedo=np.float32([0.08] * 3)))
    np.testing.assert_allclose(engine_models.ior_to_f0(surface.ior), 0.08, rtol=1e-6)
    assert float(surface.metallic) == 0


@pytest.mark.parametrize("profile", ["khr", "blender", "metalrough", "unity-legacy"])
@pytest.mark.parametrize("model", ["paper", "dielectric"])
def test_textures_convert_to_what_their_texels_convert_to(model: str, profile: str, make_texture: Texture) -> None:
    material = AssetMaterial(
        model,
        make_texture(8, 3, 0.1, 0.7),
        make_texture(8, 3, 0.02, 0.09, 1),
        make_texture(8, 1, 0.1, 0.6, 2)[..., 0],
    )
    whole = material_conversion.to_gltf(material, profile)
    texel = dataclasses.replace(
        material,
        diffuse_albedo=material.diffuse_albedo[3, 5],
        specular_albedo=material.specular_albedo[3, 5],
        roughness=material.roughness[3, 5],
    )
    alone = material_conversion.to_gltf(texel, profile)
    for field in dataclasses.fields(alone):
        value, expected = getattr(whole, field.name), getattr(alone, field.name)
        if field.name in ("residual", "warnings", "ior"):
            continue
        color = expected.ndim == 1
        np.testing.assert_allclose(
            value[3, 5] if value.ndim - color == 2 else value, expected, atol=2e-5, err_msg=field.name
        )


def test_uniform_textures_become_constants_and_maps_of_different_size_combine(make_texture: Texture) -> None:
    material = AssetMaterial("paper", np.full((4, 4, 3), 0.25), make_texture(8, 3, 0.1, 0.2), np.full((2, 2), 0.3))
    surface = material_conversion.to_gltf(material, "khr")
    assert surface.base_color.shape == (8, 8, 3) and surface.roughness.shape == () and surface.specular_weight.ndim == 2


def test_too_much_light_is_a_warning_with_its_share() -> None:
    surface = material_conversion.to_gltf(AssetMaterial("paper", [0.9] * 3, [0.5] * 3, 0.3), "khr")
    assert surface.base_color.max() == 1 and "100.0%" in surface.warnings[0]


@pytest.mark.parametrize("alpha", [1e-4, 1e-3, 1.0])
@pytest.mark.parametrize("specular", [0.0, 1e-6, 1.0])
@pytest.mark.parametrize("model", ["paper", "dielectric"])
def test_corners_of_the_parameters_stay_finite(model: str, specular: float, alpha: float) -> None:
    for diffuse in (0.0, 1.0):
        material = AssetMaterial(model, [diffuse] * 3, [specular, specular / 2, 0], alpha)
        surfaces = [material_conversion.to_gltf(material, p) for p in ("khr", "blender", "metalrough", "unity-legacy")]
        for surface in [*surfaces, material_conversion.to_usd_metallic(material)]:
            for field in dataclasses.fields(surface):
                if field.name != "warnings":
                    assert np.isfinite(getattr(surface, field.name)).all(), field.name


PROFILES = ("khr", "blender", "metalrough", "unity-legacy", "usd")


def converted(material: AssetMaterial, profile: str) -> MetallicSurface | SpecularSurface:
    return (
        material_conversion.to_usd_metallic(material)
        if profile == "usd"
        else material_conversion.to_gltf(material, profile)
    )


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("material", [GREY_PAPER, COLOR_PAPER, PLASTIC, COATED, GOLD])
def test_what_a_conversion_says_of_its_error_is_its_error(material: AssetMaterial, profile: str) -> None:
    """The residual, again from the surface alone and by the formula of the engine that reads it."""
    surface = converted(material, profile)
    alpha = float(material.roughness)
    tested = brdf_slice.brdf_slice([alpha])
    colors = [np.asarray(c, np.float64)[None] for c in (material.diffuse_albedo, material.specular_albedo)]
    wanted = brdf_slice.model_brdf(tested, material.model, *colors)
    one = np.ones(1)
    if isinstance(surface, SpecularSurface):
        written = engine_models.specular_workflow_brdf(tested, surface.diffuse[None], surface.specular[None])
    elif profile == "blender" and material.model == "paper":
        written = engine_models.blender_brdf(tested, surface.base_color[None], surface.specular_color[None])
    else:
        written = engine_models.gltf_brdf(
            tested,
            surface.base_color[None],
            surface.metallic * one,
            surface.specular_weight * one,
            surface.specular_color[None],
            surface.ior,
        )
    assert surface.residual == pytest.approx(brdf_slice.relative_error(tested, written, wanted), rel=1e-5, abs=1e-7)
    assert float(surface.roughness) == pytest.approx(np.sqrt(alpha), rel=1e-6)
    assert not surface.warnings
    for field in dataclasses.fields(surface):
        if field.name not in ("residual", "warnings", "ior"):
            assert getattr(surface, field.name).dtype == np.float32, field.name


@pytest.mark.parametrize("profile", PROFILES)
def test_maps_of_one_value_become_constants(profile: str) -> None:
    """One and three channels tell a small map from a colour: also for maps three texels wide."""
    for side in (1, 3, 8):
        material = AssetMaterial(
            "paper", np.full((side, side, 3), 0.3), np.full((side, side, 3), 0.1), np.full((side, side), 0.2)
        )
        simple = material_conversion.collapse_uniform_textures(material)
        assert simple.diffuse_albedo.shape == simple.specular_albedo.shape == (3,) and simple.roughness.shape == ()
        surface, alone = converted(material, profile), converted(simple, profile)
        for field in dataclasses.fields(surface):
            np.testing.assert_array_equal(getattr(surface, field.name), getattr(alone, field.name))


def test_surfaces_of_maps_keep_what_is_uniform_as_constants(make_texture: Texture) -> None:
    material = AssetMaterial("paper", make_texture(8, 3, 0.1, 0.4), [0.1] * 3, 0.2)
    surface = material_conversion.to_specular_workflow(dataclasses.replace(material, model="dielectric"))
    assert surface.diffuse.shape == (8, 8, 3) and surface.specular.shape == (3,)
    surface = material_conversion.to_specular_workflow(
        AssetMaterial("dielectric", [0.3] * 3, make_texture(8, 3, 0.02, 0.1), 0.2)
    )
    assert surface.diffuse.shape == (3,) and surface.specular.shape == (8, 8, 3)
    np.testing.assert_array_equal(surface.diffuse, np.float32(0.3))
    surface = material_conversion.to_gltf(material, "khr")
    assert (surface.base_color.shape, surface.specular_color.shape) == ((8, 8, 3), (3,))
    assert surface.specular_weight.shape == surface.metallic.shape == ()


@pytest.mark.parametrize(
    ("specular", "own_ior"),
    [
        ([0.08] * 3, True),
        ([0.08, 0.08 - 7e-5, 0.08], True),
        ([0.08, 0.0795, 0.08], False),
        ([0.0] * 3, False),
        ([material_conversion.METAL_F0] * 3, True),
        ([material_conversion.METAL_F0 + 1e-4] * 3, False),
        ([0.9] * 3, False),
    ],
)
def test_usd_takes_an_ior_for_grey_non_metals_only(specular: list[float], own_ior: bool) -> None:
    material = AssetMaterial("dielectric", [0.5, 0.4, 0.3], specular, 0.2)
    surface = material_conversion.to_usd_metallic(material)
    assert (surface.ior != 1.5) == own_ior
    if own_ior:
        np.testing.assert_array_equal(surface.base_color, material.diffuse_albedo)
        assert engine_models.ior_to_f0(surface.ior) == pytest.approx(specular[0], rel=1e-5)
    assert material_conversion.to_usd_metallic(dataclasses.replace(material, model="paper")).ior == 1.5


def test_usd_fits_a_map_of_grey_reflectance(make_texture: Texture) -> None:
    """One ior holds for the whole surface: a map has none, not even one of greys."""
    grey = np.repeat(make_texture(8, 1, 0.05, 0.1), 3, axis=2)
    assert material_conversion.to_usd_metallic(AssetMaterial("dielectric", [0.4] * 3, grey, 0.2)).ior == 1.5


def test_core_reflectance_has_a_tolerance_of_two_percent_each_way() -> None:
    for factor, core in [(1.019, True), (0.981, True), (1.021, False), (0.979, False), (1.03, False), (0.97, False)]:
        surface = material_conversion.to_gltf(
            dataclasses.replace(PLASTIC, specular_albedo=np.full(3, 0.04 * factor, np.float32)), "khr"
        )
        assert bool((surface.specular_color == 1).all()) == core, factor
    both = dataclasses.replace(PLASTIC, specular_albedo=np.float32([0.04, 0.05, 0.04]))
    assert not (material_conversion.to_gltf(both, "khr").specular_color == 1).all()


def test_a_paper_material_without_a_lobe_is_written_without_one() -> None:
    surface = material_conversion.to_gltf(AssetMaterial("paper", [0.5, 0.4, 0.3], [0.0] * 3, 0.3), "khr")
    assert float(surface.specular_weight) == 0 and surface.residual < 0.06
    assert float(surface.roughness) == pytest.approx(np.sqrt(0.3), rel=1e-6)
    np.testing.assert_array_equal(surface.base_color, np.float32([0.5, 0.4, 0.3]))


def test_texels_without_a_lobe_have_weight_zero_and_white(make_texture: Texture) -> None:
    specular = make_texture(8, 3, 0.1, 0.3)
    specular[2:4] = 0
    surface = material_conversion.to_gltf(AssetMaterial("paper", [0.5, 0.4, 0.3], specular, 0.3), "khr")
    f0 = float(engine_models.ior_to_f0(1000.0))
    np.testing.assert_array_equal(surface.specular_weight[2:4], 0)
    np.testing.assert_allclose(surface.specular_color[2:4] * f0, 1, rtol=1e-6)
    np.testing.assert_allclose(surface.specular_weight, specular.max(axis=-1), rtol=1e-6)
    np.testing.assert_allclose(surface.specular_color.max(axis=-1) * f0, 1, rtol=1e-6)


@pytest.mark.parametrize(("profile", "what"), [("khr", "base"), ("blender", "base"), ("unity-legacy", "diffuse")])
def test_the_warning_of_too_much_light_names_the_colour_and_the_share(profile: str, what: str) -> None:
    diffuse = np.full((4, 4, 3), 0.3, np.float32)
    diffuse[0, :, 1] = 0.98
    surface = material_conversion.to_gltf(AssetMaterial("paper", diffuse, [0.5] * 3, 0.3), profile)
    assert len(surface.warnings) == 1
    assert surface.warnings[0].startswith("25.0% of the texels") and f" {what} colour " in surface.warnings[0]
    assert not material_conversion.to_gltf(AssetMaterial("paper", diffuse / 2, [0.4] * 3, 0.3), profile).warnings


def test_maps_of_different_size_combine_at_the_larger(make_texture: Texture) -> None:
    """Each map alone large: the specular fit needs all three at one size."""
    for a, b, c in ((8, 4, 4), (4, 8, 4), (4, 4, 8)):
        albedos = make_texture(a, 3, 0.1, 0.3), make_texture(b, 3, 0.1, 0.2)
        material = AssetMaterial("paper", *albedos, make_texture(c, 1, 0.1, 0.4)[..., 0])
        for surface in (
            material_conversion.to_gltf(material, "metalrough"),
            material_conversion.to_specular_workflow(material),
        ):
            color = surface.base_color if isinstance(surface, MetallicSurface) else surface.diffuse
            assert color.shape == (8, 8, 3)
            assert surface.roughness.shape == (c, c)


def test_a_residual_is_measured_over_the_whole_texture() -> None:
    """A colour that cannot be written, in each quarter of a map in turn, is seen each time."""
    for rows, columns in [(a, b) for a in (slice(0, 4), slice(4, 8)) for b in (slice(0, 4), slice(4, 8))]:
        specular = np.full((8, 8, 3), 0.1, np.float32)
        specular[rows, columns] = [0.5, 0.1, 0.02]
        surface = material_conversion.to_gltf(AssetMaterial("paper", [0.3] * 3, specular, 0.2), "khr")
        assert surface.residual > 0.01
    assert (
        material_conversion.to_gltf(AssetMaterial("paper", [0.3] * 3, np.full((8, 8, 3), 0.1), 0.2), "khr").residual
        < 1e-6
    )
