"""`mitsuba_ggx` on a metal, a half-metal and a dielectric: its formulas against those in float64, and pictures."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hir_exporters.materials.brdf_numpy import metallic_brdf

from hir_core.scene import EnvironmentMap, Material, Scene
from hir_plugins.reflectance_renderers.mitsuba_ggx.options import MitsubaGGXOptions
from hir_plugins.reflectance_renderers.mitsuba_ggx.renderer import MitsubaGGX
from hir_plugins.reflectance_renderers.mitsuba_variant import mitsuba_on
from tests.fixtures.scenes import bumpy_sphere, icosphere, looking_at

GOLD = (0.9, 0.6, 0.2)
METALNESS = [0.0, 0.5, 1.0]


def directions(count: int, seed: int) -> np.ndarray:
    """Unit vectors of the upper hemisphere."""
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    vectors[:, 2] = np.abs(vectors[:, 2])
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def material(m: float, alpha: float, base: tuple[float, float, float] = GOLD, f0: float = 0.04) -> Material:
    return Material.metallic(torch.tensor(base), torch.tensor([m]), torch.tensor([alpha]), dielectric_f0=f0)


@pytest.mark.parametrize("m", METALNESS)
@pytest.mark.parametrize(("alpha", "f0"), [(0.02, 0.04), (0.3, 0.04), (1.0, 0.08)])
def test_drjit_formula_is_the_float64_formula(m: float, alpha: float, f0: float) -> None:
    mi = mitsuba_on("cpu")
    from hir_plugins.reflectance_renderers.mitsuba_ggx.brdf_drjit import evaluate, metallic_reflectance

    light, eye = directions(2000, 0), directions(2000, 1)
    light[:1000] = eye[:1000] * [-1, -1, 1]  # half of them in the peak
    base = np.random.default_rng(2).random((2000, 3))
    color, wi, wo = (
        kind(*v.T.astype(np.float32)) for kind, v in ((mi.Color3f, base), (mi.Vector3f, light), (mi.Vector3f, eye))
    )
    value = np.array(evaluate(metallic_reflectance(color, mi.Float(m), mi.Float(alpha), f0), wo, wi)).T
    expected = metallic_brdf(light, eye, base, np.full(2000, m), alpha, f0) * light[:, 2:]
    # float32: the half vector of a narrow lobe is what rounds
    np.testing.assert_allclose(value, expected, rtol=2e-3 if alpha < 0.1 else 1e-4, atol=1e-5)


@pytest.mark.parametrize("m", METALNESS)
def test_sampling_integrates_to_the_albedo_of_the_formula(m: float) -> None:
    """The mean weight of `sample` is the directional albedo: the integral of f cos over all lights, by quadrature."""
    mi = mitsuba_on("cpu")
    from hir_plugins.reflectance_renderers.mitsuba_ggx.brdf_drjit import evaluate, metallic_reflectance, pdf, sample

    count, alpha, n = 1 << 18, 0.3, 600
    eye = np.array([0.6, 0.0, 0.8])
    reflectance = metallic_reflectance(mi.Color3f(*GOLD), mi.Float(m), mi.Float(alpha), 0.04)
    points = np.random.default_rng(3).random((2, count)).astype(np.float32)
    towards = mi.Vector3f(*eye.tolist())
    light = sample(reflectance, towards, mi.Point2f(*points))
    value, density = np.array(evaluate(reflectance, towards, light)), np.array(pdf(reflectance, towards, light))
    weight = np.where(density > 0, value / np.maximum(density, 1e-30), 0)
    mu, phi = np.meshgrid((np.arange(n) + 0.5) / n, (np.arange(2 * n) + 0.5) * np.pi / n, indexing="ij")
    sin = np.sqrt(1 - mu * mu)
    wi = np.stack([sin * np.cos(phi), sin * np.sin(phi), mu], -1).reshape(-1, 3)
    f = metallic_brdf(wi, np.broadcast_to(eye, wi.shape), GOLD, np.full(len(wi), m), alpha)
    expected = (f * wi[:, 2:]).mean(0) * 2 * np.pi
    error = weight.std(axis=1) / np.sqrt(count)
    assert (np.abs(weight.mean(axis=1) - expected) < 4 * error + 1e-4).all()


@pytest.mark.parametrize("m", METALNESS)
def test_white_furnace(m: float) -> None:
    """A white base colour: without metal the sphere equals its white surround, with metal it is never brighter."""
    torch.manual_seed(0)
    light = EnvironmentMap(torch.ones(8, 16, 3))
    scene = Scene(icosphere(4), material(m, 0.3, (1.0, 1.0, 1.0)), light)
    image = MitsubaGGX(MitsubaGGXOptions(render_samples=256)).render(scene, looking_at((0, 0, 4), 32, 32))
    mean = float(image[..., :3][image[..., 3] == 1].mean())
    assert mean < 1 + 4e-3
    if m == 0:
        assert mean == pytest.approx(1, abs=4e-3)


@pytest.mark.parametrize("m", METALNESS)
def test_pictures_are_those_of_a_dielectric_with_its_albedos(m: float) -> None:
    """Interreflections included: the same paths with the same seed."""
    made = material(m, 0.2)
    light = EnvironmentMap(torch.rand(16, 32, 3, generator=torch.Generator().manual_seed(1)))
    plain = Material("dielectric", made.diffuse_albedo, made.specular_albedo, made.roughness)
    pictures = []
    for surface in (made, plain):
        torch.manual_seed(0)
        renderer = MitsubaGGX(MitsubaGGXOptions(render_samples=16))
        pictures.append(renderer.render(Scene(bumpy_sphere(3), surface, light), looking_at((0, 0.5, 4), 24, 24)))
    assert torch.equal(*pictures) and float(pictures[0].max()) > 0.05


def test_the_bsdf_for_mitsubas_scenes_takes_gltfs_parameters() -> None:
    mi = mitsuba_on("cpu")
    from hir_plugins.reflectance_renderers.mitsuba_ggx.ggx_bsdf import register

    register()
    rgb = {"type": "rgb", "value": list(GOLD)}
    si = mi.SurfaceInteraction3f()
    si.n, si.sh_frame = mi.Normal3f(0, 0, 1), mi.Frame3f(mi.Normal3f(0, 0, 1))
    eye, light = directions(100, 4), directions(100, 5)
    si.wi = mi.Vector3f(*eye.T.astype(np.float32))
    for m in METALNESS:
        bsdf = mi.load_dict(
            {
                "type": "hir_ggx",
                "model": "metallic",
                "base_color": rgb,
                "metalness": m,
                "alpha": 0.3,
                "dielectric_f0": 0.08,
            }
        )
        value = np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(*light.T.astype(np.float32)))).T
        expected = metallic_brdf(light, eye, GOLD, np.full(100, m), 0.3, 0.08) * light[:, 2:]
        np.testing.assert_allclose(value, expected, rtol=1e-4, atol=1e-6)
    with pytest.raises(Exception, match="known are paper, dielectric, metallic"):
        mi.load_dict({"type": "hir_ggx", "model": "velvet"})
