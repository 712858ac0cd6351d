import numpy as np
import pytest
from hir_exporters.conventions import ALPHA_MIN
from hir_exporters.materials import brdf_numpy


def hemisphere(polar: int, azimuth: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions (N, 3) and cosine-free solid angles (N,) of a midpoint grid."""
    cos = (np.arange(polar) + 0.5) / polar
    phi = (np.arange(azimuth) + 0.5) / azimuth * 2 * np.pi
    c, p = (x.ravel() for x in np.meshgrid(cos, phi, indexing="ij"))
    s = np.sqrt(1 - c * c)
    return np.stack([s * np.cos(p), s * np.sin(p), c], -1), np.full(c.size, 2 * np.pi / c.size)


def view(cos_o: float) -> np.ndarray:
    return np.array([np.sqrt(1 - cos_o**2), 0.0, cos_o])


@pytest.mark.parametrize("alpha", [0.1, 0.3, 1.0])
def test_projected_microfacets_cover_the_surface_once(alpha: float) -> None:
    directions, weight = hemisphere(40000, 4)
    area = (brdf_numpy.ggx_distribution(directions[:, 2], alpha) * directions[:, 2] * weight).sum()
    np.testing.assert_allclose(area, 1.0, rtol=2e-5)


def test_paper_model_is_the_written_formula() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        wi, wo = (v / np.linalg.norm(v) for v in (rng.normal(size=(2, 3)) * [1, 1, 0.5] + [0, 0, 1]))
        if wi[2] <= 0 or wo[2] <= 0:
            continue
        alpha, h = rng.uniform(0.05, 1), (wi + wo) / np.linalg.norm(wi + wo)
        tan2 = (1 - h[2] ** 2) / h[2] ** 2
        distribution = alpha**2 / (np.pi * h[2] ** 4 * (alpha**2 + tan2) ** 2)  # Walter et al. 2007, eq. 33
        g1 = [2 / (1 + np.sqrt(1 + alpha**2 * (1 - w[2] ** 2) / w[2] ** 2)) for w in (wi, wo)]  # eq. 34
        expected = 0.3 / np.pi + 0.7 * distribution * g1[0] * g1[1] / (4 * wi[2] * wo[2])
        np.testing.assert_allclose(brdf_numpy.paper_brdf(wi, wo, [0.3] * 3, [0.7] * 3, alpha), expected, rtol=1e-9)


@pytest.mark.parametrize(("cos_o", "alpha"), [(0.9, 0.3), (0.3, 0.5), (0.1, 0.2), (1.0, 1.0), (0.02, 0.8)])
def test_directional_albedo_is_the_integral_of_the_lobe(cos_o: float, alpha: float) -> None:
    directions, weight = hemisphere(1500, 1500)
    cos_i, o, cos_h, cos_d = brdf_numpy.half_vector_cosines(directions, view(cos_o))
    lobe = brdf_numpy.ggx_distribution(cos_h, alpha) * brdf_numpy.smith_visibility(cos_i, o, alpha) * cos_i * weight
    s = brdf_numpy.schlick_weight(cos_d)
    expected = np.array([(lobe * (1 - s)).sum(), (lobe * s).sum()])
    np.testing.assert_allclose(brdf_numpy.integrate_albedo(cos_o, alpha, index=19), expected, atol=2e-4)
    np.testing.assert_allclose(brdf_numpy.albedo_terms(cos_o, alpha), expected, atol=1.5e-3)


def test_table_is_as_accurate_as_its_documentation_says() -> None:
    rng = np.random.default_rng(0)
    cos, alpha = rng.random(1500) ** 2, np.maximum(rng.random(1500) ** 2, ALPHA_MIN)
    error = np.abs(
        np.array(brdf_numpy.albedo_terms(cos, alpha)) - np.array(brdf_numpy.integrate_albedo(cos, alpha, index=20))
    )
    assert (error[:, cos > 0.01].max(axis=1) <= [4e-4, 1.3e-3]).all()
    assert error.max() <= 0.035


def test_dielectric_under_a_white_sky_reflects_its_albedos() -> None:
    directions, weight = hemisphere(800, 800)
    wo, diffuse, f0, alpha = view(0.6), np.array([0.2, 0.5, 1.0]), np.array([0.04, 0.2, 1.0]), 0.4
    reflected = (
        brdf_numpy.dielectric_brdf(directions, wo, diffuse, f0, alpha) * (directions[:, 2] * weight)[:, None]
    ).sum(0)
    albedo = brdf_numpy.directional_albedo(0.6, alpha, f0)
    np.testing.assert_allclose(reflected, albedo + (1 - albedo) * diffuse, atol=2e-3)


def test_nothing_is_ever_infinite_and_nothing_comes_from_below() -> None:
    cosines = np.array([-1.0, -1e-9, 0.0, 1e-300, 1e-9, 1e-3, 0.5, 1.0])
    wi = np.stack([np.sqrt(1 - np.minimum(cosines**2, 1)), np.zeros(8), cosines], -1)
    i, o = np.broadcast_arrays(wi[:, None], wi[None] * [-1, 1, 1])
    for alpha in (0.0, ALPHA_MIN, 1e-2, 1.0):
        for model in (brdf_numpy.paper_brdf, brdf_numpy.dielectric_brdf):
            value = model(i, o, [0.5] * 3, [1.0] * 3, alpha)
            assert np.isfinite(value).all() and (value >= 0).all()
            assert (value[i[..., 2] <= 0] == 0).all() and (value[o[..., 2] <= 0] == 0).all()
    assert np.isfinite(brdf_numpy.albedo_terms(cosines, 0.0)).all()


def test_table_is_shared_and_cannot_be_changed() -> None:
    table = brdf_numpy.albedo_table()
    assert table is brdf_numpy.albedo_table() and table.shape == (brdf_numpy.TABLE_SIZE, brdf_numpy.TABLE_SIZE, 2)
    with pytest.raises(ValueError):
        table[0, 0] = 0
    assert table.min() >= 0 and table.sum(-1).max() <= 1 + 1e-15


def test_the_kept_table_is_the_integrated_one() -> None:
    """Where the integration changes: np.save of `integrated_table()` over exporters/hir_exporters/albedo_table.npy."""
    np.testing.assert_allclose(brdf_numpy.albedo_table(), brdf_numpy.integrated_table(), rtol=0, atol=1e-12)


@pytest.mark.parametrize(("cosine", "alpha"), [(np.nan, 0.3), (0.5, np.nan), ([0.2, np.nan], 0.3)])
def test_nan_is_no_distribution(cosine: object, alpha: float) -> None:
    with pytest.raises(ValueError, match="NaN"):
        brdf_numpy.ggx_distribution(cosine, alpha)
