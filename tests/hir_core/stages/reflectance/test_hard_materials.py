"""Hard captures: real fits to path-traced photographs of known scenes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from hir_core.errors import CaptureError, StageError
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import EnvironmentMap, Material, Scene
from hir_core.scene.bilinear import texture_texels
from hir_core.stages.atlas import unwrap_mesh
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_pyramid import texel_directions
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.renderer import TransportGGX
from tests.fixtures.made_captures import (
    BROWN,
    ROWS,
    TEXELS,
    above,
    around,
    assert_sound,
    ball,
    bowl,
    fitted,
    lamps,
    make_material,
    observed,
    painted,
    photographs,
    sky,
    unseen_db,
)
from tests.fixtures.scenes import square

# -- material -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [1e-3, 0.03, 0.3, 1.0])
def test_lobes_from_a_mirrors_to_a_matt_ones(alpha: float, tmp_path: Path) -> None:
    """A light of 16 rows cannot distinguish lobes below 0.1; a lobe of 1 may be fitted as diffuse."""
    truth = Scene(ball(), make_material((0.3, 0.2, 0.1), 0.5, alpha), lamps())
    capture = photographs(truth, around(8))
    scene, _ = fitted(
        truth.mesh, capture, tmp_path, light=lamps(), model="specular", brdf="paper", options={"steps": 400}
    )
    assert scene.material is not None
    found, rho_s = float(scene.material.roughness.mean()), float(scene.material.specular_albedo.mean())
    if alpha < 0.1:
        assert found < 0.1 and rho_s == pytest.approx(0.5, abs=0.1)
    elif alpha < 1:
        assert found == pytest.approx(alpha, rel=0.15) and rho_s == pytest.approx(0.5, abs=0.1)
    assert unseen_db(scene, truth) > 28


@pytest.mark.parametrize("albedo", [0.0, pytest.param(1.0, marks=pytest.mark.slow)])
def test_black_and_white(albedo: float, tmp_path: Path) -> None:
    """Under a known light a black ball is black and a white one white, in every observed texel."""
    truth = Scene(ball(), make_material((albedo,) * 3), sky())
    scene, report = fitted(truth.mesh, photographs(truth, around(8)), tmp_path, light=sky(), model="diffuse")
    values, _ = observed(scene)
    assert report.solver["observed"] > 0.8
    assert float((values - albedo).abs().max()) < 0.05


@pytest.mark.slow
def test_white_beside_black_is_as_white_as_alone(tmp_path: Path) -> None:
    """In sRGB a black pixel weighs as much as a thousand white ones; it must not darken the white side."""
    mesh = ball()
    texture, surface = painted(mesh, lambda p: (p[:, :1] > 0).float().expand(-1, 3))
    truth = Scene(mesh, make_material(texture), sky())
    scene, report = fitted(mesh, photographs(truth, around(10)), tmp_path, light=sky(), model="diffuse")
    assert scene.material is not None and scene.material.observed is not None
    right = torch.zeros_like(surface.covered)
    right[surface.covered] = surface.position[:, 0] > 0.2
    assert report.solver["observed"] > 0.9
    assert float(scene.material.observed[right].float().mean()) > 0.9
    assert float(scene.material.diffuse_albedo[right].mean()) > 0.95
    assert unseen_db(scene, truth) > 26


@pytest.mark.slow
def test_a_mirror_like_metal_has_a_coloured_reflection(tmp_path: Path) -> None:
    """The light is known, because a tinted light looks the same."""
    gold = torch.tensor([0.9, 0.6, 0.2])
    mirror = Material.metallic(gold, torch.ones(1), torch.full((1,), 1e-3))
    truth = Scene(ball(), mirror, lamps(32))
    scene, report = fitted(
        truth.mesh,
        photographs(truth, around(12)),
        tmp_path,
        light=lamps(32),
        environment_height=32,
        environment_width=64,
    )
    # `mixed` is 0.8 dB ahead while both still converge, which nobody has explained; it finds metal everywhere
    assert report.explanation is not None and report.explanation.chosen.startswith(("metal", "mixed")), (
        report.explanation
    )
    assert scene.material is not None and scene.material.metalness is not None
    _, seen = observed(scene)
    metalness = scene.material.metalness
    assert float((metalness[seen] if metalness.ndim == 3 else metalness).min()) > 0.99
    base = scene.material.base_color
    found = base[seen].mean(dim=0) if base.ndim == 3 else base
    torch.testing.assert_close(found, gold, atol=0.1, rtol=0)
    assert float(scene.material.roughness.mean()) < 0.05
    assert unseen_db(scene, truth) > 34


# -- views ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_grazing_views(tmp_path: Path) -> None:
    """A square that is observed only from 12° above its plane."""
    mesh, low = square(), np.radians(12)
    texture, _ = painted(mesh, lambda p: 0.5 + 0.3 * p[:, [0, 2, 0]] * torch.tensor([1.0, 1.0, -1.0]))
    shards, out, up = np.arange(8) * np.pi / 4, 4 * np.cos(low), 4 * np.sin(low)
    eyes = [(out * np.sin(a), up, out * np.cos(a)) for a in shards]
    truth = Scene(mesh, make_material(texture), sky())
    scene, report = fitted(
        mesh, photographs(truth, eyes, size=64), tmp_path, light=sky(), model="diffuse", options={"vertices": 2000}
    )
    values, seen = observed(scene)
    assert report.solver["observed"] > 0.3
    assert float((values - texture[seen]).abs().mean()) < 0.02


@pytest.mark.parametrize("model", ["diffuse", "auto"])
def test_views_that_all_graze_end_with_one_clear_sentence(model: str, tmp_path: Path) -> None:
    """From 4° above a plane a pixel covers too much of it."""
    mesh, low, shards = square(), np.radians(4), np.arange(8) * np.pi / 4
    eyes = [(4 * np.cos(low) * np.sin(a), 4 * np.sin(low), 4 * np.cos(low) * np.cos(a)) for a in shards]
    truth = Scene(mesh, make_material(BROWN), sky())
    with pytest.raises(
        StageError, match=r"from more than 6 degrees: mesh, masks and cameras .* inspect them with: hir check"
    ):
        fitted(mesh, photographs(truth, eyes, size=64), tmp_path, light=sky(), model=model)


@pytest.mark.slow
def test_a_fully_clipped_view_changes_nothing(tmp_path: Path) -> None:
    """Its known exposure is 100 times that of the others: all its pixels are clipped."""
    truth = Scene(ball(), make_material(BROWN), lamps())
    capture = photographs(truth, around(8), exposures=[100.0] + [1.0] * 7)
    first = capture.views[0].read()
    assert first.mask is not None and first.saturated[first.mask > 0].all()
    scene, _ = fitted(truth.mesh, capture, tmp_path, light=lamps(), model="diffuse")
    values, _ = observed(scene)
    assert float((values - torch.tensor(BROWN)).abs().mean()) < 0.01
    assert unseen_db(scene, truth) > 45


def test_fully_clipped_views_are_refused(tmp_path: Path) -> None:
    truth = Scene(ball(), make_material(BROWN), lamps())
    capture = photographs(truth, around(8), exposures=[300.0] * 8)
    with pytest.raises(CaptureError, match=r"every pixel of the object is clipped in all 8 photographs"):
        fitted(truth.mesh, capture, tmp_path, options={"steps": 50})


@pytest.mark.slow
def test_one_view_that_is_not_clipped_gives_a_finite_scene(tmp_path: Path) -> None:
    """Seven of eight views are clipped everywhere: they must neither break the fit nor count as observations."""
    truth = Scene(ball(), make_material(BROWN), lamps())
    capture = photographs(truth, around(8), exposures=[300.0] * 7 + [1.0])
    scene, report = fitted(truth.mesh, capture, tmp_path, options={"steps": 50})
    assert scene.material is not None and scene.environment is not None
    for values in (scene.material.diffuse_albedo, scene.material.roughness, scene.environment.radiance):
        assert bool(torch.isfinite(values).all())
    assert 0.15 < report.solver["observed"] < 0.3, "what one view shows of a ball (measured: 0.234), and no more"


def test_one_view(tmp_path: Path) -> None:
    """It is fitted without a comparison; the far side is marked as unobserved and inpainted."""
    mesh, eye = ball(), (0.5, 1.0, 3.8)
    texture, surface = painted(mesh, lambda p: 0.5 + 0.3 * p)
    truth = Scene(mesh, make_material(texture), sky())
    warnings: list[str] = []
    scene, report = fitted(mesh, photographs(truth, [eye]), tmp_path, warnings=warnings)
    assert report.comparisons == () and any("1 views are too few" in text for text in warnings)
    values, seen = observed(scene)
    away = surface.normal @ torch.nn.functional.normalize(torch.tensor(eye), dim=0) < 0
    assert 0.05 < report.solver["observed"] < 0.5 and not bool(seen[surface.covered][away].any())
    assert unseen_db(scene, truth, eye) > 30
    assert scene.material is not None
    filled = scene.material.diffuse_albedo[surface.covered]
    assert float(filled.min()) >= float(values.min()) - 1e-6 and float(filled.max()) <= float(values.max()) + 1e-6


def test_unobserved_texels_are_marked_and_inpainted_smoothly(tmp_path: Path) -> None:
    mesh = ball()
    texture, surface = painted(mesh, lambda p: 0.5 + 0.3 * p)
    angles = [(-0.5, 0.3), (-0.25, -0.2), (0.0, 0.3), (0.2, -0.3), (0.45, 0.1), (0.6, -0.2)]
    eyes = [(4 * np.sin(a), 4 * y, 4 * np.cos(a)) for a, y in angles]
    truth = Scene(mesh, make_material(texture), sky())
    scene, _ = fitted(mesh, photographs(truth, eyes), tmp_path, light=sky(), model="diffuse")
    values, seen = observed(scene)
    assert scene.material is not None
    albedo, front = scene.material.diffuse_albedo, surface.position[:, 2]
    marked = seen[surface.covered]
    assert float(marked[front > 0.4].float().mean()) > 0.9 and not bool(marked[front < -0.4].any())
    assert float((values - texture[seen]).abs().mean()) < 0.01
    hidden = surface.covered & ~seen
    low, high = values.min(dim=0).values - 1e-6, values.max(dim=0).values + 1e-6
    assert bool(((albedo[hidden] >= low) & (albedo[hidden] <= high)).all())
    for dim in (0, 1):
        pair = hidden.narrow(dim, 1, TEXELS - 1) & surface.covered.narrow(dim, 0, TEXELS - 1)
        step = (albedo.narrow(dim, 1, TEXELS - 1) - albedo.narrow(dim, 0, TEXELS - 1)).abs().amax(dim=2)
        true = (texture.narrow(dim, 1, TEXELS - 1) - texture.narrow(dim, 0, TEXELS - 1)).abs().amax(dim=2)
        assert float(step[pair].max()) < 3 * float(true[pair].max())


# -- light ----------------------------------------------------------------------------------------------------------


def mean_direction(light: EnvironmentMap) -> Tensor:
    """Where most of the light comes from, unit."""
    rows, columns = light.radiance.shape[:2]
    weight = torch.sin((torch.arange(rows) + 0.5) * torch.pi / rows)[:, None] * light.radiance.mean(dim=2)
    return torch.nn.functional.normalize(weight.reshape(-1) @ texel_directions(rows, columns), dim=0)


@pytest.mark.slow
def test_a_light_with_one_bright_texel(tmp_path: Path) -> None:
    radiance = torch.full((ROWS, 2 * ROWS, 3), 0.1)
    radiance[4, 9] = 40.0
    truth = Scene(ball(), make_material(BROWN), EnvironmentMap(radiance))
    scene, report = fitted(truth.mesh, photographs(truth, around(10)), tmp_path)
    assert report.model == "diffuse" and scene.environment is not None
    assert divmod(int(scene.environment.radiance.mean(dim=2).argmax()), 2 * ROWS) == (4, 9)
    assert float(mean_direction(scene.environment) @ mean_direction(EnvironmentMap(radiance))) > np.cos(np.radians(3))
    values, _ = observed(scene)
    assert float(values.log().std(dim=0).max()) < 0.1, "no shading in the albedo"


@pytest.mark.slow
def test_a_light_that_is_upside_down(tmp_path: Path) -> None:
    upright = sky()
    found = []
    for name, light in (("up", upright), ("down", replace(upright, radiance=upright.radiance.flip(0)))):
        truth = Scene(ball(), make_material(BROWN), light)
        scene, _ = fitted(truth.mesh, photographs(truth, around(10)), tmp_path / name, model="diffuse")
        assert scene.environment is not None
        assert float(mean_direction(scene.environment) @ mean_direction(light)) > np.cos(np.radians(3))
        assert unseen_db(scene, truth) > 40
        found.append(observed(scene)[0].mean(dim=0))
    torch.testing.assert_close(found[0], found[1], rtol=0.03, atol=0)


# -- shape and texture ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_deep_bowl_needs_indirect_light(tmp_path: Path) -> None:
    """The photographs have six bounces; a fit with one is closer to the albedo than a fit with none."""
    mesh, color = unwrap_mesh(bowl(), 128)[0], torch.tensor([0.6, 0.4, 0.2])
    truth = Scene(mesh, make_material(color), sky())
    eyes = above(10, 0.7)
    start = replace(truth, material=Material("paper", torch.full((128, 128, 3), 0.5), torch.zeros(3), torch.ones(1)))
    options = TransportGGXOptions(vertices=0, cache_cells=2000)
    solver = TransportGGX(options).prepare(start, photographs(truth, eyes, depth=8, size=48))
    place = mesh.positions
    inside = (place[:, [0, 2]].norm(dim=1) < 0.84) & (place[:, 1] < 0.1) & (place.norm(dim=1) < 0.92)
    errors = []
    for bounces in range(3):
        fit = solver.fit(ModelSpec(bounces=bounces, light_is_known=True), None, range(10), 1.0, lambda _: None)
        assert_sound(solver.scene(fit, range(10), lambda _: None).scene)
        errors.append(float((fit.parameters.diffuse_albedo[inside].mean(dim=0) - color).abs().max()))
    assert errors[0] > 0.3 and errors[1] < 0.4 * errors[0] and errors[2] < 0.05


def test_seams_do_not_show(tmp_path: Path) -> None:
    """The fitted texture has the same colour on both sides of each seam edge."""
    mesh = ball()
    texture, _ = painted(mesh, lambda p: 0.5 + 0.3 * p)
    truth = Scene(mesh, make_material(texture), sky())
    scene, _ = fitted(mesh, photographs(truth, around(12, 0.9)), tmp_path, light=sky(), model="diffuse")
    assert scene.material is not None and mesh.uvs is not None and mesh.topology.uv_faces is not None
    sides: dict[tuple[int, int], list[Tensor]] = {}
    for face, corners in zip(mesh.faces.tolist(), mesh.uvs[mesh.topology.uv_faces], strict=True):
        for i, j in ((0, 1), (1, 2), (2, 0)):
            edge = (min(face[i], face[j]), max(face[i], face[j]))
            sides.setdefault(edge, []).append((corners[i] + corners[j]) / 2)
    cut = {edge: uv for edge, uv in sides.items() if float((uv[0] - uv[1]).abs().max()) > 2 / TEXELS}
    assert len(cut) > 50
    index, weight = texture_texels(torch.cat([torch.stack(uv) for uv in cut.values()]), TEXELS, TEXELS)
    steps = []
    for shown in (scene.material.diffuse_albedo, texture):
        both = (shown.reshape(-1, 3)[index] * weight[..., None]).sum(dim=1).reshape(-1, 2, 3)
        steps.append((both[:, 0] - both[:, 1]).abs())
    # the true colours, each at its texel's centre, step by what a texel is wide
    assert float(steps[0].mean()) < 1.5 * float(steps[1].mean())
    assert float(steps[0].max()) < 1.5 * float(steps[1].max())


@pytest.mark.slow
@pytest.mark.parametrize("texels", [64, 512, 1024])
def test_textures_of_any_size(texels: int, tmp_path: Path) -> None:
    """A texture that is finer than the photographs gets the colours of the vertices between their pixels."""
    mesh = ball(texels)
    texture, _ = painted(mesh, lambda p: 0.5 + 0.3 * torch.sin(4 * p), 512)
    truth = Scene(mesh, make_material(texture), sky())
    scene, report = fitted(
        mesh,
        photographs(truth, around(10), size=64),
        tmp_path,
        texels=texels,
        light=sky(),
        model="diffuse",
        options={"vertices": 2000},
    )
    values, seen = observed(scene)
    assert scene.material is not None and scene.material.diffuse_albedo.shape == (texels, texels, 3)
    resized = torch.nn.functional.interpolate(texture.permute(2, 0, 1)[None], (texels, texels), mode="bilinear")[0]
    assert float((values - resized.permute(1, 2, 0)[seen]).abs().mean()) < 0.015
    assert report.solver["observed"] > 0.95 and unseen_db(scene, truth) > (40 if texels == 64 else 34)
