"""The BRDF functions against their definitions, in float64 and at the limits of their domain."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from hir_exporters.materials.brdf_numpy import albedo_terms, dielectric_brdf, metallic_brdf, paper_brdf

from hir_core.scene import Material
from hir_plugins.reflectance_renderers import brdf_torch
from hir_plugins.reflectance_renderers.brdf_torch import evaluate, ggx_d, smith_g1

MODELS = ("paper", "dielectric", "metallic")


def unit(rng: np.random.Generator, count: int) -> torch.Tensor:
    """Directions of the upper hemisphere."""
    v = rng.normal(size=(count, 3))
    v[:, 2] = np.abs(v[:, 2])
    return torch.from_numpy(v / np.linalg.norm(v, axis=1, keepdims=True))


def cosines(wi: torch.Tensor, wo: torch.Tensor) -> dict[str, torch.Tensor]:
    h = torch.nn.functional.normalize(wi + wo, dim=-1)
    return {
        "n_wi": wi[..., 2:],
        "n_wo": wo[..., 2:],
        "n_h": h[..., 2:],
        "h_wo": (h * wo).sum(-1, keepdim=True),
        "sin2_h": h[..., :2].square().sum(-1, keepdim=True),
    }


def hemisphere_grid(n: int) -> tuple[torch.Tensor, float]:
    """Directions of equal solid angle and that solid angle."""
    mu = (torch.arange(n, dtype=torch.float64) + 0.5) / n
    phi = (torch.arange(2 * n, dtype=torch.float64) + 0.5) / (2 * n) * 2 * math.pi
    mu, phi = torch.meshgrid(mu, phi, indexing="ij")
    sin = (1 - mu * mu).sqrt()
    return torch.stack([sin * phi.cos(), sin * phi.sin(), mu], -1).reshape(-1, 3), 2 * math.pi / (2 * n * n)


@pytest.mark.parametrize("alpha", [0.05, 0.3, 1.0])
def test_normal_density_integrates_to_one(alpha: float) -> None:
    mu = (torch.arange(400_000, dtype=torch.float64) + 0.5) / 400_000
    density = ggx_d(mu, torch.tensor(alpha, dtype=torch.float64))
    assert float((density * mu).mean() * 2 * math.pi) == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("alpha", [0.2, 0.5, 1.0])
@pytest.mark.parametrize("cos_o", [0.05, 0.5, 1.0])
def test_masking_conserves_the_visible_area(alpha: float, cos_o: float) -> None:
    """`∫ G1(wo) max(0, wo·h) D(h) dh = cos_o`, which defines Smith's G1 (Heitz 2014, eq. 14)."""
    h, solid_angle = hemisphere_grid(600)
    wo = torch.tensor([math.sqrt(1 - cos_o**2), 0, cos_o], dtype=torch.float64)
    a = torch.tensor(alpha, dtype=torch.float64)
    area = (smith_g1(wo[2], a) * (h @ wo).clamp_min(0) * ggx_d(h[:, 2], a)).sum() * solid_angle
    assert float(area) == pytest.approx(cos_o, rel=2e-3)


def test_the_albedo_is_the_exporters_own() -> None:
    """The fit and the export couple the diffuse part by the same table."""
    rng = np.random.default_rng(0)
    cos, alpha = rng.random(2000), rng.uniform(1e-4, 1, 2000)
    ours = brdf_torch.directional_albedo_terms(torch.from_numpy(cos), torch.from_numpy(alpha))
    for mine, theirs in zip(ours, albedo_terms(cos, alpha), strict=True):
        np.testing.assert_allclose(mine.numpy(), theirs, rtol=0, atol=1e-12)


@pytest.mark.parametrize("alpha", [1e-4, 0.02, 0.3, 1.0])
@pytest.mark.parametrize(("model", "reference"), [("paper", paper_brdf), ("dielectric", dielectric_brdf)])
def test_values_are_the_exporters_formulas(model: str, reference: Callable[..., np.ndarray], alpha: float) -> None:
    """Two implementations that share only the table agree to rounding."""
    rng = np.random.default_rng(5)
    wi, wo = unit(rng, 400), unit(rng, 400)
    wi[:200] = wo[:200] * torch.tensor([-1.0, -1.0, 1.0])  # half of them in the peak
    rho_d, rho_s = rng.random((400, 3)), rng.random((400, 3))
    values = evaluate(
        model,
        torch.from_numpy(rho_d),
        torch.from_numpy(rho_s),  # type: ignore[arg-type]
        torch.tensor([alpha], dtype=torch.float64),
        **cosines(wi, wo),
    )
    expected = reference(wi.numpy(), wo.numpy(), rho_d, rho_s, alpha) * wi.numpy()[:, 2:]
    np.testing.assert_allclose(values.numpy(), expected, rtol=1e-6)


@pytest.mark.parametrize("alpha", [1e-4, 0.02, 0.3, 1.0])
@pytest.mark.parametrize("m", [0.0, 0.5, 1.0])
def test_metallic_values_are_the_exporters_formula(m: float, alpha: float) -> None:
    """A metal, a half-metal and a dielectric, from `Material`'s albedos, against the formula in the parameters."""
    rng = np.random.default_rng(6)
    wi, wo = unit(rng, 400), unit(rng, 400)
    wi[:200] = wo[:200] * torch.tensor([-1.0, -1.0, 1.0])  # half of them in the peak
    base = torch.from_numpy(rng.random(3))
    width = torch.tensor([alpha], dtype=torch.float64)
    made = Material.metallic(base, torch.tensor([m], dtype=torch.float64), width, dielectric_f0=0.06)
    values = evaluate(made.model, made.diffuse_albedo, made.specular_albedo, width, **cosines(wi, wo))
    expected = metallic_brdf(wi.numpy(), wo.numpy(), base.numpy(), np.full(400, m), alpha, 0.06) * wi.numpy()[:, 2:]
    np.testing.assert_allclose(values.numpy(), expected, rtol=1e-6)


@pytest.mark.parametrize("alpha", [1e-4, 1e-3, 0.03, 0.5, 1.0])
def test_paper_model_is_reciprocal(alpha: float) -> None:
    rng = np.random.default_rng(1)
    wi, wo = unit(rng, 500), unit(rng, 500)
    rho = torch.rand(500, 3, dtype=torch.float64), torch.rand(500, 3, dtype=torch.float64)
    a = torch.tensor([alpha], dtype=torch.float64)
    there = evaluate("paper", *rho, a, **cosines(wi, wo)) / wi[:, 2:]
    back = evaluate("paper", *rho, a, **cosines(wo, wi)) / wo[:, 2:]
    torch.testing.assert_close(there, back, rtol=1e-10, atol=0)


def test_dielectric_lobe_is_reciprocal() -> None:
    """The lobe is; the coupled diffuse part depends on the eye's direction alone, by its definition."""
    rng = np.random.default_rng(2)
    wi, wo = unit(rng, 500), unit(rng, 500)
    black, rho_s, a = torch.zeros(3), torch.rand(500, 3, dtype=torch.float64), torch.tensor([0.2], dtype=torch.float64)
    there = evaluate("dielectric", black, rho_s, a, **cosines(wi, wo)) / wi[:, 2:]
    back = evaluate("dielectric", black, rho_s, a, **cosines(wo, wi)) / wo[:, 2:]
    torch.testing.assert_close(there, back, rtol=1e-9, atol=0)


@pytest.mark.parametrize("alpha", [0.15, 0.4, 1.0])
@pytest.mark.parametrize("cos_o", [0.05, 0.3, 1.0])
def test_white_furnace(alpha: float, cos_o: float) -> None:
    """In a white surround nothing reflects more than it receives; a white coupled dielectric reflects everything."""
    wi, solid_angle = hemisphere_grid(600)
    wo = torch.tensor([[math.sqrt(1 - cos_o**2), 0, cos_o]], dtype=torch.float64)
    a, one = torch.tensor([alpha], dtype=torch.float64), torch.ones(1, dtype=torch.float64)

    def reflected(model: str, rho_d: float, rho_s: float) -> float:
        values = evaluate(model, one * rho_d, one * rho_s, a, **cosines(wi, wo))  # type: ignore[arg-type]
        return float(values.sum() * solid_angle)

    for rho_s in (0.0, 0.04, 0.5, 1.0):
        assert reflected("dielectric", 1, rho_s) == pytest.approx(1, abs=3e-3)
        assert reflected("paper", 1 - rho_s, rho_s) <= 1 + 1e-3
    assert reflected("paper", 0.7, 0) == pytest.approx(0.7, abs=1e-6)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("model", MODELS)
def test_extreme_values_stay_finite(model: str, dtype: torch.dtype) -> None:
    """Every combination of extreme values, also impossible ones."""
    cos = torch.tensor([-1.0, -1e-9, 0.0, 1e-12, 1e-4, 0.5, 1.0, 1.0 + 1e-6], dtype=dtype)
    alphas = torch.tensor([-1.0, 0.0, 1e-4, 1e-3, 0.5, 1.0, 2.0], dtype=dtype)
    n_wi, n_wo, n_h, h_wo, alpha = (
        t[..., None].clone().requires_grad_() for t in torch.meshgrid(cos, cos, cos, cos, alphas, indexing="ij")
    )
    rho_d = torch.tensor([0.0, 0.5, 1.0], dtype=dtype, requires_grad=True)
    rho_s = torch.tensor([0.0, 0.04, 1.0], dtype=dtype, requires_grad=True)
    value = evaluate(model, rho_d, rho_s, alpha, n_wi, n_wo, n_h, h_wo)  # type: ignore[arg-type]
    assert torch.isfinite(value).all()
    assert (value >= 0).all()
    for gradient in torch.autograd.grad(value.sum(), (n_wi, n_wo, n_h, h_wo, alpha), allow_unused=True):
        assert gradient is None or torch.isfinite(gradient).all()  # the paper's model does not use h·wo


@pytest.mark.parametrize("model", MODELS)
def test_gradients_match_finite_differences(model: str) -> None:
    rng = np.random.default_rng(3)
    wi, wo = unit(rng, 40), unit(rng, 40)
    fixed = cosines(wi, wo)
    shapes = ((40, 3), (40, 3), (40, 1))
    inputs = [torch.from_numpy(rng.uniform(0.05, 0.95, shape)).requires_grad_() for shape in shapes]
    assert torch.autograd.gradcheck(
        lambda d, s, a: evaluate(model, d, s, a, **fixed), inputs, eps=1e-7, rtol=1e-5, atol=1e-6
    )  # type: ignore[arg-type]


def test_narrow_lobe_in_float32_with_the_sine() -> None:
    """alpha = 1e-3 in float32 agrees with float64 when |n × h|² is given."""
    rng = np.random.default_rng(4)
    xy = rng.normal(size=(300, 2)) * 1e-3
    h = np.concatenate([xy, np.sqrt(1 - (xy**2).sum(1, keepdims=True))], axis=1)
    exact = ggx_d(torch.from_numpy(h[:, 2]), torch.tensor(1e-3, dtype=torch.float64), torch.from_numpy((xy**2).sum(1)))
    single = ggx_d(torch.from_numpy(h[:, 2]).float(), torch.tensor(1e-3), torch.from_numpy((xy**2).sum(1)).float())
    torch.testing.assert_close(single.double(), exact, rtol=1e-5, atol=0)


def test_shapes_broadcast_over_light_directions() -> None:
    """Per-pixel parameters (P, 1, 3) against directions (P, L, 1)."""
    one = torch.full((5, 1, 1), 0.3)
    value = evaluate(
        "dielectric",
        one.expand(5, 1, 3),
        one.expand(5, 1, 3),
        one,
        torch.rand(5, 7, 1),
        one,
        torch.rand(5, 7, 1),
        torch.rand(5, 7, 1),
    )
    assert value.shape == (5, 7, 3)


@pytest.mark.parametrize("alpha", [1e-3, 0.1, 1.0])
def test_opposite_directions_have_no_half_vector_and_no_lobe(alpha: float) -> None:
    """A grazing sample can be reflected to the opposite direction: one in ten million samples of a fit."""
    width = torch.tensor([alpha], requires_grad=True)
    nothing = torch.zeros(1)
    value = brdf_torch.specular_lobe(width, torch.tensor([-0.1]), torch.tensor([0.1]), nothing, nothing)
    value.sum().backward()
    assert float(value.detach()) == 0 and width.grad is not None and bool(torch.isfinite(width.grad).all())
