"""BRDFs of single points: against a float64 reference by autograd, and with few or extreme photographs."""

from __future__ import annotations

import math
from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest
import torch
from hir_exporters.conventions import ALPHA_MIN
from torch import Tensor
from torch.nn.functional import grid_sample, huber_loss, normalize

from hir_core.scene.srgb import linear_to_srgb
from hir_plugins.reflectance_renderers.brdf_torch import directional_albedo_terms
from hir_plugins.reflectance_renderers.mitsuba_variant import mitsuba_on
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_pyramid import texel_directions
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.lobe_moments import moment_table, width_table
from hir_plugins.reflectance_renderers.transport_ggx.operator.probe_lookup import (
    Lobe,
    Patch,
    ProbeTable,
    lobe_of,
    patch_around,
    patch_radiance,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.radiance_probes import (
    ALPHA_LEVELS,
    MIN_LEVEL_ALPHA,
    PROBE_COLUMNS,
    PROBE_ROWS,
    RadianceProbes,
    alpha_of,
    level_of,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.shading_normals import (
    offset_normals,
    shading_normal_irradiance,
)
from hir_plugins.reflectance_renderers.transport_ggx.textures.brdf_fit import PointBrdfFit
from hir_plugins.reflectance_renderers.transport_ggx.textures.brdf_fit_state import (
    MIN_SPECULAR_ALBEDO,
    ObservedPoints,
    PointBrdfs,
    Priors,
    ShadingPoints,
)
from hir_plugins.reflectance_renderers.transport_ggx.textures.brdf_fit_steps import normal_equations
from hir_plugins.reflectance_renderers.transport_ggx.textures.observations import Observations

COUNT, VIEWS = 64, 24


@pytest.fixture(autouse=True)
def _on_the_processor() -> None:
    mitsuba_on("cpu")


def probes() -> RadianceProbes:
    """Two cells: a window ahead and a lamp to the side, wider and dimmer in each level."""
    d = texel_directions(PROBE_ROWS, PROBE_COLUMNS)
    ahead, aside = normalize(torch.tensor([[0.3, 0.4, 1.0], [-1.0, 0.5, 0.2]]), dim=1)
    levels = []
    for level in range(ALPHA_LEVELS):
        sharp = 40.0 / (1 + 2 * level)
        window, lamp = torch.exp(sharp * (d @ ahead - 1)), torch.exp(sharp * (d @ aside - 1))
        levels.append(torch.stack([0.3 + 3 * window + 0.5 * lamp, 0.3 + 2.5 * window + lamp, 0.4 + 2 * window], dim=1))
    one = torch.stack(levels)
    return RadianceProbes(torch.stack([one, 0.5 * one + 0.2]).half())


def points(generator: torch.Generator) -> ShadingPoints:
    normal = normalize(torch.randn(COUNT, 3, generator=generator) + torch.tensor([0.0, 0.0, 2.0]), dim=1)
    cell = torch.arange(COUNT) % 2
    irradiance = 2 + torch.rand(COUNT, 3, generator=generator)
    vectors = 0.8 * torch.randn(COUNT, 3, 3, generator=generator)
    return ShadingPoints(normal.clone(), normal, cell, irradiance, vectors)


def brdfs(albedo: Tensor, specular: Tensor, alpha: Tensor, normal_offset: Tensor) -> PointBrdfs:
    """Of a model without metalness."""
    return PointBrdfs(albedo, specular, alpha, normal_offset, torch.zeros_like(alpha))


def metallic(base: Tensor, metalness: Tensor, alpha: Tensor, normal_offset: Tensor) -> PointBrdfs:
    """glTF's model with an F0 of 0.04."""
    diffuse, specular = (1 - metalness) * base, (1 - metalness) * 0.04 + metalness * base
    return PointBrdfs(diffuse, specular, alpha, normal_offset, metalness)


def truth(generator: torch.Generator) -> PointBrdfs:
    def draw(low: float, high: float, channels: int) -> Tensor:
        return low + (high - low) * torch.rand(COUNT, channels, generator=generator)

    return brdfs(draw(0.1, 0.6, 3), draw(0.1, 0.5, 3), draw(0.15, 0.5, 1), draw(-0.3, 0.3, 3))


def vectors(values: Tensor) -> mi.Vector3f:
    return mi.Vector3f(*(mi.Float(values[:, axis].numpy().copy()) for axis in range(3)))


def eyes(generator: torch.Generator) -> Tensor:
    return 4 * normalize(torch.randn(VIEWS, 3, generator=generator) + torch.tensor([0.0, 0.0, 2.5]), dim=1)


def reference(at: ShadingPoints, values: PointBrdfs, toward: Tensor, light: RadianceProbes, model: str) -> Tensor:
    """Radiance (P, 3) in float64, differentiable but for the part of ρs in the direction of the lobe."""
    n = at.normal.double()
    turned = offset_normals(n, values.normal_offset)
    arriving = shading_normal_irradiance(n, turned, at.irradiance.double(), at.vectors.double()) / math.pi
    cosine = (turned * toward).sum(1, keepdim=True).clamp_min(1e-3)
    a, b = (t[:, None] for t in directional_albedo_terms(cosine[:, 0], values.alpha[:, 0]))
    rho_s = values.specular.detach().mean(1, keepdim=True) if model != "paper" else 1.0
    main, width = mean_direction(turned, toward, values.alpha, rho_s * a, b)
    level = (width - math.log(MIN_LEVEL_ALPHA)) / -math.log(MIN_LEVEL_ALPHA) * (ALPHA_LEVELS - 1)
    u = 0.5 - torch.atan2(main[:, 0], main[:, 2]) / (2 * math.pi)
    v = torch.atan2((main[:, 0].square() + main[:, 2].square()).sqrt(), main[:, 1]) / math.pi
    table = light.radiance.double().reshape(len(light.radiance), ALPHA_LEVELS, PROBE_ROWS, PROBE_COLUMNS, 3)
    table = torch.cat([table[:, :, :, -1:], table, table[:, :, :, :1]], dim=3)[at.cell].permute(0, 4, 1, 2, 3)
    place = torch.stack(
        [
            2 * (u * PROBE_COLUMNS + 0.5) / (PROBE_COLUMNS + 1) - 1,
            2 * (v * PROBE_ROWS - 0.5) / (PROBE_ROWS - 1) - 1,
            2 * level[:, 0].clamp(0, ALPHA_LEVELS - 1) / (ALPHA_LEVELS - 1) - 1,
        ],
        dim=1,
    )[:, None, None, None]
    lobe = grid_sample(table, place, align_corners=True, padding_mode="border")[:, :, 0, 0, 0]
    if model == "paper":
        return values.albedo * arriving + lobe * values.specular * (a + b)
    reflected = values.specular * a + b
    return values.albedo * (1 - reflected).clamp_min(0) * arriving + lobe * reflected


def mean_direction(normal: Tensor, toward: Tensor, alpha: Tensor, plain: Tensor, bias: Tensor) -> tuple[Tensor, Tensor]:
    """Unit direction (P, 3) of the lobe, and log α of its width (P, 1)."""
    cosine = (normal * toward).sum(1, keepdim=True).clamp_min(1e-3)
    lowest = math.sqrt(ALPHA_MIN)
    place = torch.cat([(alpha.sqrt() - lowest) / (1 - lowest), cosine.sqrt()], dim=1) * 2 - 1
    table = torch.from_numpy(moment_table().copy()).permute(2, 0, 1)[None]
    means = grid_sample(table, place[None, None], align_corners=True)[0, :, 0].T
    both = (plain * means[:, :2] + bias * means[:, 2:]) / (plain + bias)
    x, z = both[:, :1], both[:, 1:]
    length = (x.square() * (1 - cosine.square()) + z.square()).sqrt()
    place = torch.cat([2 * (1 - length).sqrt() - 1, torch.zeros_like(length)], dim=1)
    table = torch.from_numpy(width_table().copy())[None, None, None]
    width = grid_sample(table, place[None, None], align_corners=True)[0, 0].T
    return normalize(x * (cosine * normal - toward) + z * normal, dim=1), width


def double(values: PointBrdfs) -> PointBrdfs:
    return PointBrdfs(*(value.double() for value in values.all()))


def photographs(
    at: ShadingPoints, values: PointBrdfs, light: RadianceProbes, stand: Tensor, model: str
) -> Observations:
    color, weight = torch.zeros(VIEWS, COUNT, 3), torch.zeros(VIEWS, COUNT)
    for row, eye in enumerate(stand):
        toward = normalize(eye - at.position, dim=1)
        color[row] = reference(at, double(values), toward.double(), light, model).float()
        weight[row] = (at.normal * toward).sum(1).clamp_min(0) * ((at.normal * toward).sum(1) > 0.15)
    return Observations(color, weight, stand, torch.full((VIEWS, 3), torch.inf))


def grey() -> PointBrdfs:
    return brdfs(
        torch.full((COUNT, 3), 0.3), torch.full((COUNT, 3), 0.1), torch.full((COUNT, 1), 0.3), torch.zeros(COUNT, 3)
    )


@pytest.mark.parametrize("model", ["paper", "dielectric"])
def test_radiance_is_the_references(model: str) -> None:
    generator = torch.Generator().manual_seed(1)
    at, values, light, stand = points(generator), truth(generator), probes(), eyes(generator)
    seen = photographs(at, values, light, stand, model)
    fit = PointBrdfFit([ObservedPoints(at, seen, ProbeTable(light))], model, Priors())  # type: ignore[arg-type]
    toward = normalize(stand[0] - at.position, dim=1)
    shown, wanted = fit.predict(values, toward), reference(at, double(values), toward.double(), light, model)
    assert torch.allclose(shown.double(), wanted, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("model", ["paper", "dielectric"])
def test_fitted_points_predict_other_views(model: str) -> None:
    generator = torch.Generator().manual_seed(2)
    at, values, light = points(generator), truth(generator), probes()
    seen = photographs(at, values, light, eyes(generator), model)
    fit = PointBrdfFit([ObservedPoints(at, seen, ProbeTable(light))], model, Priors(iterations=40))  # type: ignore[arg-type]
    found, _ = fit.solve(grey())
    elsewhere = normalize(eyes(generator)[0] - at.position, dim=1)
    off = linear_to_srgb(fit.predict(found, elsewhere)) - linear_to_srgb(fit.predict(values, elsewhere))
    assert off.abs().median() < 0.003
    plain, _ = PointBrdfFit([ObservedPoints(at, seen, ProbeTable(light))], model, Priors.of_albedo()).solve(grey())  # type: ignore[arg-type]
    without = linear_to_srgb(fit.predict(plain, elsewhere)) - linear_to_srgb(fit.predict(values, elsewhere))
    # 0.054 to 0.057, however many iterations: what is left is the pull of the priors
    assert off.square().mean() < 0.07 * without.square().mean()
    assert torch.allclose(plain.specular, grey().specular) and torch.allclose(
        plain.normal_offset, grey().normal_offset, atol=1e-6
    )


@pytest.mark.parametrize("model", ["paper", "dielectric"])
def test_points_are_fitted_to_the_photographs_of_two_takes(model: str) -> None:
    """Each take has its own irradiance and probes. The BRDFs predict views of both, and their albedos are nearer
    to the truth than from one take.
    """
    generator = torch.Generator().manual_seed(2)
    first, values = points(generator), truth(generator)
    irradiance, table = 1 + torch.rand(COUNT, 3, generator=generator), probes().radiance
    second = ShadingPoints(first.position, first.normal, 1 - first.cell, irradiance, -0.5 * first.vectors)
    lights = probes(), RadianceProbes(0.7 * table.roll(3, dims=2))
    takes = []
    for at, light in zip((first, second), lights, strict=True):
        seen = photographs(at, values, light, eyes(generator), model)
        takes.append(ObservedPoints(at, seen, ProbeTable(light)))
    fit = PointBrdfFit(takes, model, Priors(iterations=40))  # type: ignore[arg-type]
    found, _ = fit.solve(grey())
    elsewhere, take = normalize(eyes(generator)[0] - first.position, dim=1), torch.arange(COUNT) // 2 % 2
    wanted = torch.zeros(COUNT, 3).double()
    for number, (at, light) in enumerate(zip((first, second), lights, strict=True)):
        shown = reference(at, double(values), elsewhere.double(), light, model)
        wanted = torch.where((take == number)[:, None], shown, wanted)
    off = linear_to_srgb(fit.predict(found, elsewhere, take)).double() - linear_to_srgb(wanted)
    assert off.abs().median() < 0.003
    alone, _ = PointBrdfFit(takes[:1], model, Priors(iterations=40)).solve(grey())  # type: ignore[arg-type]
    errors = [float((each.albedo - values.albedo).abs().mean()) for each in (found, alone)]
    assert errors[0] < 0.75 * errors[1]


def test_photographs_of_one_take_in_two_parts_give_the_same_equations() -> None:
    """Also where one part has a photograph that shows nothing."""
    generator = torch.Generator().manual_seed(7)
    at, values, light = points(generator), truth(generator), probes()
    seen = photographs(at, values, light, eyes(generator), "dielectric")

    def photographs_of(rows: slice) -> ObservedPoints:
        own = Observations(seen.color[rows], seen.weight[rows], seen.eyes[rows], seen.ceiling[rows])
        return ObservedPoints(at, own, ProbeTable(light))

    blind = photographs_of(slice(0, 1))
    nothing = Observations(
        *(torch.zeros_like(each) for each in (blind.observations.color, blind.observations.weight)),
        blind.observations.eyes,
        blind.observations.ceiling,
    )
    found = []
    for takes in (
        [photographs_of(slice(None))],
        [photographs_of(slice(0, 9)), photographs_of(slice(9, None)), replace(blind, observations=nothing)],
    ):
        fit = PointBrdfFit(takes, "dielectric", Priors())
        state = fit.state(grey())
        equations = normal_equations(fit.takes, state, state)
        found.append(
            [np.array(each) for each in (equations.cost, *equations.colors, *equations.mixed, *equations.shared)]
        )
    for one, two in zip(*found, strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-4, atol=1e-5)


@pytest.mark.slow
def test_least_squares_reach_the_cost_of_gradient_descent() -> None:
    """Adam in float64 on the same energy: a slow reference that shares no code."""
    generator = torch.Generator().manual_seed(3)
    at, light, priors = points(generator), probes(), Priors(iterations=40)
    seen = photographs(at, truth(generator), light, eyes(generator), "dielectric")
    color = (seen.color * (1 + 0.2 * torch.randn(seen.color.shape, generator=generator))).clamp_min(0)
    noisy = Observations(color, seen.weight, seen.eyes, seen.ceiling)
    _, cost = PointBrdfFit([ObservedPoints(at, noisy, ProbeTable(light))], "dielectric", priors).solve(grey())
    start, few = double(grey()), 12
    row = torch.arange(few).repeat(VIEWS)  # each of the first points in each view
    many = ShadingPoints(*(getattr(at, name)[row] for name in ShadingPoints.__dataclass_fields__))
    toward = normalize(noisy.eyes.repeat_interleave(few, 0).double() - many.position.double(), dim=1)
    wanted = linear_to_srgb(noisy.color[:, :few].reshape(-1, 3).double())
    weight, normal = noisy.weight[:, :few].reshape(-1).double(), at.normal[:few].double()
    free = [torch.logit(start.albedo), torch.logit(start.specular), level_of(start.alpha), start.normal_offset]
    free = [value[:few].detach().clone().requires_grad_() for value in free]
    optimizer = torch.optim.Adam(free, lr=0.05)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, 300)
    for _ in range(300):
        values = brdfs(torch.sigmoid(free[0]), torch.sigmoid(free[1]), alpha_of(free[2]), free[3])
        row_brdfs = PointBrdfs(*(getattr(values, name)[row] for name in PointBrdfs.__dataclass_fields__))
        off = linear_to_srgb(reference(many, row_brdfs, toward, light, "dielectric").clamp_min(0)) - wanted
        part = weight * huber_loss(off, torch.zeros_like(off), delta=priors.huber_srgb, reduction="none").sum(1)
        along = values.normal_offset - (values.normal_offset * normal).sum(1, keepdim=True) * normal
        held = priors.albedo * (values.albedo - start.albedo[:few]).square().sum(1)
        held = held + priors.specular * (values.specular - start.specular[:few]).square().sum(1)
        held = held + priors.level * (free[2] - level_of(start.alpha[:few])).square()[:, 0]
        total = part.sum() + 0.5 * (held + priors.normal_offset * along.square().sum(1)).sum()
        optimizer.zero_grad()
        total.backward()
        optimizer.step()
        schedule.step()
    assert cost[:few].double().sum() < 1.01 * total.detach()


def test_a_patch_interpolates_the_probe_and_extrapolates_nearby() -> None:
    """The patch of a lobe gives that lobe exactly and a nearby one approximately, also across the panorama's seam."""
    light = ProbeTable(probes())
    angle = torch.linspace(0, 2 * math.pi, 257)[:-1]  # all around, so some are at the seam
    eye = torch.stack([torch.sin(angle), torch.full_like(angle, 0.3), torch.cos(angle)], dim=1)

    def looking(turn: float) -> Lobe:  # aside and rougher
        normal = torch.stack([torch.sin(angle + turn), torch.full_like(angle, 0.3 + turn), torch.cos(angle + turn)], 1)
        level = mi.Float(2.4 + 10 * turn)
        return lobe_of(vectors(normalize(normal, dim=1)), vectors(normalize(eye, dim=1)), level, mi.Float(0.1), 1.0)

    def read(patch: Patch, lobe: Lobe) -> Tensor:
        return torch.from_numpy(np.array(patch_radiance(patch, lobe))).T

    here, aside = looking(0.0), looking(0.01)
    patch, other = (patch_around(light.values, mi.UInt32(0), lobe) for lobe in (here, aside))
    change, wanted = read(patch, aside) - read(patch, here), read(other, aside) - read(patch, here)
    assert wanted.norm() > 0.1, "nothing changes here, so nothing is shown"
    assert (change - wanted).norm() < 0.15 * wanted.norm()
    alike = torch.from_numpy(np.array((patch.left == other.left) & (patch.top == other.top)))
    assert 100 < alike.sum() < 256, "some stay within their texels, others leave them"
    assert torch.allclose(change[alike], wanted[alike], atol=1e-5)
    seam = torch.from_numpy(np.array(patch.left < 0))
    assert 0 < seam.sum() < 20 and torch.allclose(change[seam & alike], wanted[seam & alike], atol=1e-5)


@pytest.mark.parametrize("model", ["paper", "dielectric"])
def test_normal_equations_contain_the_gradient_of_the_cost(model: str) -> None:
    """Against autograd in float64: exact for albedo and ρs, as accurate as differences for α and the normal offset."""
    generator = torch.Generator().manual_seed(5)
    at, light, values, stand = points(generator), probes(), truth(generator), eyes(generator)
    seen = photographs(at, truth(generator), light, stand, model)
    fit = PointBrdfFit([ObservedPoints(at, seen, ProbeTable(light))], model, Priors(0, 0, 0, 0))  # type: ignore[arg-type]
    state = fit.state(values)
    equations = normal_equations(fit.takes, state, state)
    de, fe, ae, e1, e2 = (torch.from_numpy(np.array(value)).double() for value in equations.errors)
    free = double(values)
    level = level_of(free.alpha).requires_grad_()
    for value in (free.albedo, free.specular, free.normal_offset):
        value.requires_grad_()
    cost = torch.zeros((), dtype=torch.float64)
    for row in range(VIEWS):
        toward = normalize(stand[row].double() - at.position.double(), dim=1)
        now = brdfs(free.albedo, free.specular, alpha_of(level), free.normal_offset)
        off = linear_to_srgb(reference(at, now, toward, light, model)) - linear_to_srgb(seen.color[row].double())
        part = huber_loss(off, torch.zeros_like(off), delta=fit.takes[0].priors.huber_srgb, reduction="none").sum(dim=1)
        cost = cost + (seen.weight[row].double() * part).sum()
    assert float(np.array(equations.cost).sum()) == pytest.approx(float(cost.detach()), rel=1e-4)
    by_albedo, by_specular, by_level, by_offset = torch.autograd.grad(
        cost, (free.albedo, free.specular, level, free.normal_offset)
    )
    assert torch.allclose(de.T, by_albedo, rtol=1e-3, atol=1e-4)
    assert torch.allclose(fe.T, by_specular, rtol=1e-3, atol=1e-4)
    tangent, bitangent = (axis.double() for axis in fit._frame)
    wanted = torch.stack([by_level[:, 0], (by_offset * tangent).sum(1), (by_offset * bitangent).sum(1)])
    found = torch.stack([ae, e1, e2])
    for mine, true in zip(found, wanted, strict=True):
        assert (mine - true).norm() < 0.1 * true.norm()


@pytest.mark.parametrize("case", ["unseen", "black", "white", "sun", "nonsense", "one view", "dark light", "far away"])
@pytest.mark.parametrize("model", ["paper", "dielectric"])
def test_hard_cases_stay_finite_and_physical(case: str, model: str) -> None:
    generator = torch.Generator().manual_seed(4)
    at, light = points(generator), probes()
    seen = photographs(at, truth(generator), light, eyes(generator), model)
    color, weight, ceiling = seen.color, seen.weight, seen.ceiling
    if case == "unseen":
        weight = torch.zeros_like(weight)
    elif case == "black":
        color = torch.zeros_like(color)
    elif case == "white":
        color, ceiling = torch.ones_like(color), torch.full_like(ceiling, 0.97)
    elif case == "sun":
        light = RadianceProbes((light.radiance.float() * 1e4).clamp(max=65504).half())
        at = ShadingPoints(at.position, at.normal, at.cell, at.irradiance * 1e4, at.vectors * 1e4)
    elif case == "nonsense":
        color = torch.rand(color.shape, generator=generator) * 5
    elif case == "one view":
        weight = weight * (torch.arange(VIEWS) == 0)[:, None]
    elif case == "dark light":
        light = RadianceProbes(torch.zeros_like(light.radiance))
        at = ShadingPoints(at.position, at.normal, at.cell, at.irradiance * 0, at.vectors * 0)
    elif case == "far away":
        at = ShadingPoints(at.position + 1e6, at.normal, at.cell, at.irradiance, at.vectors)
    fit = PointBrdfFit(
        [ObservedPoints(at, Observations(color, weight, seen.eyes, ceiling), ProbeTable(light))], model, Priors()
    )  # type: ignore[arg-type]
    found, cost = fit.solve(grey())
    for value in (found.albedo, found.specular, found.alpha, found.normal_offset, cost):
        assert torch.isfinite(value).all()
    assert (found.albedo >= 0).all() and (found.albedo <= 1).all()
    assert (found.specular >= MIN_SPECULAR_ALBEDO).all() and (found.specular <= 1).all()
    assert (found.alpha > 0).all() and (found.alpha <= 1 + 1e-6).all()
    if model == "paper":
        assert (found.albedo + found.specular <= 1 + 2 * MIN_SPECULAR_ALBEDO).all()
    assert torch.isfinite(fit.predict(found, at.normal)).all()
    if case == "unseen":
        assert torch.allclose(found.albedo, grey().albedo, atol=1e-5) and torch.allclose(found.alpha, grey().alpha)


def metallic_truth(generator: torch.Generator) -> PointBrdfs:
    """Half metal, half dielectric, of any colour."""
    base = 0.2 + 0.8 * torch.rand(COUNT, 3, generator=generator)
    alpha = 0.15 + 0.35 * torch.rand(COUNT, 1, generator=generator)
    metal = (torch.arange(COUNT) % 4 < 2).float()[:, None]
    return metallic(base, metal, alpha, 0.4 * torch.rand(COUNT, 3, generator=generator) - 0.2)


def undecided() -> PointBrdfs:
    """Grey, half a metal."""
    return metallic(torch.full((COUNT, 3), 0.5), torch.full((COUNT, 1), 0.5), grey().alpha, grey().normal_offset)


def test_fitted_metallic_points_predict_other_views_and_know_metal() -> None:
    generator = torch.Generator().manual_seed(6)
    at, values, light = points(generator), metallic_truth(generator), probes()
    seen = photographs(at, values, light, eyes(generator), "metallic")
    fit = PointBrdfFit([ObservedPoints(at, seen, ProbeTable(light))], "metallic", Priors(iterations=40))
    found, _ = fit.solve(undecided())
    elsewhere = normalize(eyes(generator)[0] - at.position, dim=1)
    off = linear_to_srgb(fit.predict(found, elsewhere)) - linear_to_srgb(fit.predict(values, elsewhere))
    before = linear_to_srgb(fit.predict(undecided(), elsewhere)) - linear_to_srgb(fit.predict(values, elsewhere))
    assert off.abs().median() < 0.1 * before.abs().median() and off.abs().median() < 0.01
    metal = values.metalness > 0.5
    assert found.metalness[metal].mean() > found.metalness[~metal].mean() + 0.4
    base = found.albedo + found.specular - 0.04 * (1 - found.metalness)
    expected = metallic(base, found.metalness, found.alpha, found.normal_offset)
    torch.testing.assert_close(found.albedo, expected.albedo, rtol=0, atol=1e-5)
    torch.testing.assert_close(found.specular, expected.specular, rtol=0, atol=1e-5)


@pytest.mark.parametrize("model", ["dielectric", "metallic"])
def test_the_albedo_alone(model: str) -> None:
    """Metalness, α and normals stay, and so does ρs of a dielectric; the albedos of a metal follow its base colour."""
    generator = torch.Generator().manual_seed(7)
    metal = model == "metallic"
    at, values, light = points(generator), metallic_truth(generator) if metal else truth(generator), probes()
    seen = photographs(at, values, light, eyes(generator), model)
    flat = torch.full((COUNT, 3), 0.5)
    priors = Priors.of_base_color() if metal else Priors.of_albedo()
    wrong = metallic(flat, values.metalness, values.alpha, values.normal_offset)
    if not metal:
        wrong = brdfs(flat, values.specular, values.alpha, values.normal_offset)
    found, _ = PointBrdfFit([ObservedPoints(at, seen, ProbeTable(light))], model, priors).solve(wrong)  # type: ignore[arg-type]
    torch.testing.assert_close(found.metalness, values.metalness, rtol=0, atol=1e-5)
    torch.testing.assert_close(found.alpha, values.alpha, rtol=1e-4, atol=0)
    turned = offset_normals(at.normal, values.normal_offset)
    torch.testing.assert_close(offset_normals(at.normal, found.normal_offset), turned, rtol=0, atol=1e-4)
    error, before = (
        (each.albedo + each.specular - values.albedo - values.specular).abs().median() for each in (found, wrong)
    )
    assert error < 0.2 * before


@pytest.mark.slow
def test_metallic_least_squares_reach_the_cost_of_gradient_descent() -> None:
    """Adam in float64 on the same energy of base colour, metalness, level and normal offset."""
    generator = torch.Generator().manual_seed(8)
    at, light, priors = points(generator), probes(), Priors(iterations=40)
    seen = photographs(at, metallic_truth(generator), light, eyes(generator), "metallic")
    color = (seen.color * (1 + 0.2 * torch.randn(seen.color.shape, generator=generator))).clamp_min(0)
    noisy = Observations(color, seen.weight, seen.eyes, seen.ceiling)
    _, cost = PointBrdfFit([ObservedPoints(at, noisy, ProbeTable(light))], "metallic", priors).solve(undecided())
    start, few = double(undecided()), 12
    row = torch.arange(few).repeat(VIEWS)
    many = ShadingPoints(*(getattr(at, name)[row] for name in ShadingPoints.__dataclass_fields__))
    toward = normalize(noisy.eyes.repeat_interleave(few, 0).double() - many.position.double(), dim=1)
    wanted = linear_to_srgb(noisy.color[:, :few].reshape(-1, 3).double())
    weight, normal = noisy.weight[:, :few].reshape(-1).double(), at.normal[:few].double()
    base = torch.zeros(few, 3, dtype=torch.float64)
    free = [base, base[:, :1], level_of(start.alpha[:few]), start.normal_offset[:few]]
    free = [value.detach().clone().requires_grad_() for value in free]
    optimizer = torch.optim.Adam(free, lr=0.05)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, 300)
    for _ in range(300):
        values = metallic(torch.sigmoid(free[0]), torch.sigmoid(free[1]), alpha_of(free[2]), free[3])
        off = linear_to_srgb(reference(many, values.take(row), toward, light, "metallic").clamp_min(0)) - wanted
        part = weight * huber_loss(off, torch.zeros_like(off), delta=priors.huber_srgb, reduction="none").sum(1)
        along = values.normal_offset - (values.normal_offset * normal).sum(1, keepdim=True) * normal
        held = priors.albedo * (values.albedo - start.albedo[:few]).square().sum(1)
        held = held + priors.specular * (values.specular - start.specular[:few]).square().sum(1)
        held = held + priors.metalness * (values.metalness - start.metalness[:few]).square()[:, 0]
        held = held + priors.level * (free[2] - level_of(start.alpha[:few])).square()[:, 0]
        total = part.sum() + 0.5 * (held + priors.normal_offset * along.square().sum(1)).sum()
        optimizer.zero_grad()
        total.backward()
        optimizer.step()
        schedule.step()
    assert cost[:few].double().sum() < 1.02 * total.detach()
