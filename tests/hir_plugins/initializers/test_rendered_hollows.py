"""Hollows of what reflects: found where a hollow renders like the photographs and a lid does not."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from hir_core.capture import Capture
from hir_core.scene import EnvironmentMap, Material, Mesh, Scene, Topology
from hir_plugins.initializers.hollows import rendered_search
from hir_plugins.initializers.hollows.hollows import Hollows
from hir_plugins.initializers.hollows.outline_search import OutlineSearch
from hir_plugins.initializers.hollows.photo_prediction import blurred_photographs
from hir_plugins.initializers.hollows.rendered_prediction import Appearance, squared_errors
from hir_plugins.initializers.hollows.rendered_search import RenderedHollow, find_rendered_hollows
from hir_plugins.initializers.options import HollowsOptions
from hir_plugins.initializers.surface.volume import Volume
from hir_plugins.reflectance_renderers.mitsuba_ggx.options import MitsubaGGXOptions
from hir_plugins.reflectance_renderers.mitsuba_ggx.renderer import MitsubaGGX
from tests.fixtures.silhouette_captures import dome, make_view
from tests.hir_plugins.initializers.test_hollows import block, cup, height_inside, hull_of, lid_of_the_box

SIDE = 80
STEEL = Material.metallic(torch.tensor([0.7, 0.65, 0.6]), torch.ones(1), torch.full((1,), 0.35))
PLASTER = Material("dielectric", torch.full((3,), 0.6), torch.full((3,), 0.04), torch.ones(1))


def sky() -> EnvironmentMap:
    """A dim sky and three lamps of ten degrees, which cast shadows and highlights."""
    rows, columns = np.meshgrid(np.linspace(0, np.pi, 64), np.linspace(0, 2 * np.pi, 128), indexing="ij")
    directions = np.stack([np.sin(rows) * np.sin(columns), np.cos(rows), np.sin(rows) * np.cos(columns)], axis=-1)
    light = 0.1 + 0.1 * np.cos(rows).clip(0)
    for toward, power in (((0.7, 1.0, 0.3), 20.0), ((-0.8, 0.9, -0.4), 12.0), ((0.1, 0.8, -1.0), 8.0)):
        cosine = directions @ (np.array(toward) / np.linalg.norm(toward))
        light += power * np.exp(60 * (cosine - 1))
    return EnvironmentMap(torch.from_numpy(light.astype(np.float32))[..., None] * torch.tensor([1.0, 0.95, 0.9]))


def scene_of(mesh: trimesh.Trimesh, material: Material, frame: str = "world") -> Scene:
    # the renderer interpolates normals: edges are sharp where triangles are small
    mesh = mesh.subdivide_to_size(0.06)
    positions = torch.from_numpy(np.array(mesh.vertices, np.float32))
    topology = Topology(torch.from_numpy(np.array(mesh.faces, np.int64)))
    return Scene(Mesh(positions, topology), material, replace(sky(), frame=frame))


def photographed(scene: Scene, gains: tuple[float, ...] = (1.0,), take: str = "", count: int = 24) -> Capture:
    renderer = MitsubaGGX(MitsubaGGXOptions(max_depth=8, render_samples=64))
    views = []
    for i, camera in enumerate(dome(count, 3.0, np.zeros(3), 1.6 * SIDE, SIDE)):
        torch.manual_seed(i)
        image = renderer.render(scene, camera).numpy()
        gain = gains[i % len(gains)]
        view = make_view(f"{take}{i}", camera, (image[..., 3] > 0.5).astype(np.float32), gain * image[..., :3])
        views.append(replace(view, exposure=gain, take=take))
    return Capture(Path("made-in-memory"), tuple(views))


def hollowed(capture: Capture, fitted: Scene, most: int = 1) -> tuple[Scene, list[dict[str, float]]]:
    initializer = Hollows(HollowsOptions(vertex_colors=False, max_hollows=most))
    same, found = initializer.initialize(capture, fitted, Path("unused"))
    assert same is capture and found is not None
    described = initializer.report()["hollows"]
    assert isinstance(described, list)
    return found, described


@pytest.mark.slow
@pytest.mark.parametrize("material", [STEEL, PLASTER], ids=["steel", "plaster"])
def test_a_cup_is_hollow(material: Material) -> None:
    true = scene_of(cup(), material)
    capture = photographed(true)
    fitted = replace(true, mesh=hull_of(capture).mesh)
    found, hollows = hollowed(capture, fitted)
    assert height_inside(fitted) > 0.3 and height_inside(found) < -0.15, "the floor is at -0.3"
    assert hollows[0]["share_of_error_saved"] > 0.7 > 0 > hollows[0]["explained_before"]


@pytest.mark.slow
@pytest.mark.parametrize("material", [STEEL, PLASTER], ids=["steel", "plaster"])
@pytest.mark.parametrize("frame", ["world", "camera"])
def test_a_block_stays_as_it_is(material: Material, frame: str) -> None:
    true = scene_of(block(), material, frame)
    capture = photographed(true)
    fitted = replace(true, mesh=hull_of(capture).mesh)
    found, hollows = hollowed(capture, fitted)
    assert found is fitted and hollows == []


@pytest.mark.slow
def test_a_dark_spot_is_no_hollow(monkeypatch: pytest.MonkeyPatch) -> None:
    """The top of a block of plaster is darker than its side. One colour all over explains it worse than a hollow does,
    the fitted maps explain it.
    """
    scene = scene_of(block(), PLASTER)
    across = torch.linspace(-1.2, 1.2, 256)
    dark = (across[:, None] ** 2 + across**2 < 0.5**2)[..., None]
    texture = torch.where(dark, 0.1, 0.6).expand(256, 256, 3)
    mesh = replace(
        scene.mesh,
        topology=Topology(scene.mesh.faces, scene.mesh.faces),
        uvs=scene.mesh.positions[:, [0, 2]] / 2.4 + 0.5,
    )
    true = replace(scene, mesh=mesh, material=replace(PLASTER, diffuse_albedo=texture))
    capture = photographed(true)
    found, hollows = hollowed(capture, true)
    assert found is true and hollows == []
    monkeypatch.setattr(rendered_search, "WELL_EXPLAINED", 1.1)
    assert len(hollowed(capture, true)[1]) == 1, "else this test would show nothing"
    monkeypatch.setattr(rendered_search, "WELL_EXPLAINED", -100.0)
    monkeypatch.delattr(OutlineSearch, "sunk")
    assert hollowed(capture, true)[1] == [], "what the maps explain is not sunk first to be rejected afterwards"


def test_the_true_surface_renders_like_the_photographs_and_a_lid_does_not() -> None:
    true = scene_of(cup(), STEEL)
    capture = photographed(true, gains=(1.0, 0.5), count=8)
    photographs = blurred_photographs(capture, 1e-4)
    appearance = Appearance.of(true, capture.takes)
    above = [i for i in range(8) if photographs[i].camera.center[1] > 1.5]
    pixels = {i: np.argwhere(photographs[i].valid)[::7, ::-1] for i in above}
    errors = {}
    for name, mesh in (("true", cup()), ("lid", block())):
        fine = mesh.subdivide_to_size(0.06)
        triangles = np.asarray(fine.vertices), np.asarray(fine.faces)
        radiance = appearance.radiance(triangles, photographs, pixels, 64, 0)
        found = squared_errors(radiance, photographs, pixels)
        half = {i: np.arange(len(chosen)) % 2 == 0 for i, chosen in pixels.items()}
        scaled = squared_errors(radiance, photographs, pixels, half)
        assert list(found) == above and all(np.isfinite(each).all() for each in found.values())
        errors[name] = [np.mean(np.concatenate(list(each.values()))) for each in (found, scaled)]
    assert errors["true"][0] < 6e-3 < 0.03 < errors["lid"][0], errors
    assert errors["true"][1] < 6e-3 and errors["lid"][1] < errors["lid"][0], errors


def test_each_take_has_its_light() -> None:
    true = scene_of(block(), PLASTER)
    assert true.environment is not None
    half = 0.5 * true.environment.radiance
    lit = replace(true, take_radiance={"a": true.environment.radiance, "b": half})
    first = photographed(true, take="a", count=2)
    both = replace(first, views=first.views + tuple(replace(v, name=f"b{v.name}", take="b") for v in first.views))
    photographs = blurred_photographs(both, 1e-4)
    appearance = Appearance.of(lit, both.takes)
    pixels = {i: np.argwhere(photographs[0].valid)[::9, ::-1] for i in (0, 2)}
    triangles = np.asarray(block().vertices), np.asarray(block().faces)
    radiance = appearance.radiance(triangles, photographs, pixels, 64, 0)
    assert radiance[0].mean() == pytest.approx(2 * radiance[2].mean(), rel=0.02)


def test_one_material_is_the_median_of_the_observed_texels() -> None:
    maps = torch.rand(8, 8, 3, generator=torch.Generator().manual_seed(0))
    observed = torch.zeros(8, 8, dtype=torch.bool)
    observed[2:5] = True
    rough = torch.full((1,), 0.3)
    for material in (
        Material("dielectric", maps, torch.full((3,), 0.04), rough, observed=observed),
        Material.metallic(maps, torch.ones(8, 8, 1), rough, observed=observed),
    ):
        scene = replace(scene_of(block(), PLASTER), material=material)
        found = Appearance.of(scene, ("",)).material
        color = found.base_color if found.metalness is not None else found.diffuse_albedo
        assert color.shape == (3,) and torch.allclose(color, maps[2:5].reshape(-1, 3).median(dim=0).values)
        assert found.roughness.item() == pytest.approx(0.3)


@pytest.mark.parametrize(
    "change",
    [{"reduction": 0.4}, {"explained_repainted": -0.1}, {"gain": 1.0}, {"explained_by_maps": 0.95}],
    ids=lambda change: next(iter(change)),
)
def test_a_hollow_must_save_half_of_the_error(change: dict[str, float]) -> None:
    hollow = RenderedHollow(lid_of_the_box(6), 9, np.zeros((1, 1, 1)), -2.0, 0.3, 0.7, 5.0, 0.4, 0.7, 16)
    assert hollow.is_confirmed and not replace(hollow, **change).is_confirmed


def test_what_is_thin_has_no_hollow() -> None:
    find = partial(find_rendered_hollows, photographs=[], appearance=None, seed=0, most=1)  # type: ignore[arg-type]
    assert find(Volume(np.full((8, 8, 8), -0.3, np.float32), np.zeros(3), 0.1)) == []
