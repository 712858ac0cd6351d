"""A lamp near the camera: its formula, derivatives and shadows, against code that shares nothing with it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from hir_exporters.materials.brdf_numpy import dielectric_brdf, paper_brdf
from torch import Tensor

from hir_core.scene import CameraLamp, EnvironmentMap, Material, Mesh, Scene, Topology
from hir_plugins.reflectance_renderers.mitsuba_ggx.options import MitsubaGGXOptions
from hir_plugins.reflectance_renderers.mitsuba_ggx.renderer import MitsubaGGX
from hir_plugins.reflectance_renderers.mitsuba_variant import mitsuba_on
from hir_plugins.reflectance_renderers.transport_ggx.operator.camera_lamp import (
    LampCameras,
    LampPoints,
    lamp_irradiance,
    lamp_lobe,
    turned_disc,
)
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.renderer import TransportGGX
from tests.fixtures.scenes import icosphere, looking_at

LAMP = CameraLamp(torch.tensor([30.0, 20.0, 10.0]), torch.tensor([0.4, -0.6, 0.1]), torch.tensor(3.0))
EYE = (0.6, 1.0, 3.5)
ARRAYS = ("toward_camera", "normal", "to_eye", "axes", "origin")
"""Of `LampPoints`, a row for each point."""


def double(lamp: CameraLamp = LAMP) -> CameraLamp:
    return CameraLamp(*(value.double() for value in (lamp.intensity, lamp.offset, lamp.exponent, lamp.radius)))


def points(count: int = 40) -> LampPoints:
    """Points near the origin, in float64, before a camera that looks at it; normals within 50° of it."""
    camera = looking_at(EYE, 64, 64)
    rng = np.random.default_rng(0)
    position = rng.uniform(-0.6, 0.6, (count, 3))
    toward = camera.center - position
    to_eye = toward / np.linalg.norm(toward, axis=1, keepdims=True)
    normal = to_eye + rng.uniform(-0.5, 0.5, (count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    rotation = camera.world_to_camera[:3, :3].astype(np.float64)
    axes = np.repeat(rotation[None], count, axis=0)
    in_camera = [vector @ rotation.T for vector in (toward, normal, to_eye)]
    arrays = [torch.from_numpy(a.astype(np.float64)) for a in (*in_camera, axes, position)]
    disc = turned_disc(count, arrays[0])
    return LampPoints(*arrays, None, disc, torch.ones(disc.shape[:2], dtype=torch.bool))  # type: ignore[arg-type]


def shaded(at: LampPoints, lamp: CameraLamp, alpha: Tensor, diffuse: float, specular: float, model: str) -> Tensor:
    """Radiance by the parts that a fit uses, without the energy that the lobe takes from the diffuse part."""
    rays = at.rays(lamp)
    white, grazing = lamp_lobe(rays, alpha)
    lobe = specular * white if model == "paper" else specular * (white - grazing) + grazing
    return diffuse * lamp_irradiance(rays) / torch.pi + lobe


@pytest.mark.parametrize(("model", "formula"), [("paper", paper_brdf), ("dielectric", dielectric_brdf)])
@pytest.mark.parametrize("alpha", [0.05, 0.4])
def test_radiance_is_the_formula_of_a_point_of_light(model: str, formula: Any, alpha: float) -> None:
    """In numpy, in the axes of the camera: intensity · cos(θ)^k / r² · f · (n·wi)."""
    at = points()
    normal, wo = at.normal.numpy(), at.to_eye.numpy()
    toward = at.toward_camera.numpy() + LAMP.offset.double().numpy()
    distance = np.linalg.norm(toward, axis=1, keepdims=True)
    wi = toward / distance
    irradiance = LAMP.intensity.double().numpy() * (-wi[:, 2:]) ** 3 / distance**2
    tangent = np.cross(normal, [0.3, 0.5, 0.8])
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    frame = np.stack([tangent, np.cross(normal, tangent), normal], axis=1)
    local_i, local_o = (np.einsum("nij,nj->ni", frame, v) for v in (wi, wo))
    # without the diffuse part: a fit multiplies it by 1 − E itself
    value = formula(local_i, local_o, [0.0] * 3, [0.3] * 3, alpha) + 0.5 / np.pi * (local_i[:, 2:] > 0)
    expected = value * irradiance * np.maximum(local_i[:, 2:], 0)
    found = shaded(at, double(), torch.tensor([[alpha]], dtype=torch.float64), 0.5, 0.3, model)
    np.testing.assert_allclose(found.numpy(), expected, rtol=1e-9, atol=1e-12)
    assert (expected > 0).mean() > 0.9


@pytest.mark.parametrize("model", ["paper", "dielectric"])
def test_derivatives_are_those_of_finite_differences(model: str) -> None:
    """In float64: lamp, width of the lobe and normals; also for a lamp at the camera's centre, a point and a disc."""
    at = points(8)
    normals = (at.axes.mT @ at.normal[..., None])[..., 0]
    for offset, radius in ((LAMP.offset, 0.5), (LAMP.offset, 0.0), (torch.zeros(3), 0.5)):
        leaves = (LAMP.intensity, offset, LAMP.exponent, torch.tensor(radius), torch.full((8, 1), 0.2), normals)
        inputs = [leaf.double().clone().requires_grad_() for leaf in leaves]

        def radiance(*values: Tensor) -> Tensor:
            *lamp, alpha, normal = values
            return shaded(at.with_normals(normal), CameraLamp(*lamp), alpha, 0.5, 0.3, model)

        assert torch.autograd.gradcheck(radiance, inputs, eps=1e-6, atol=1e-6, rtol=1e-6)


def test_a_disc_is_the_mean_of_points_of_light() -> None:
    """Of many points of light on a disc across the viewing axis, each by the formula of a point. Its own few points are
    turned for each pixel, so that the mean of 400 equal pixels has hardly an error."""
    large, one, count, alpha = 1.5, points(1), 20_000, torch.full((1, 1), 0.15, dtype=torch.float64)

    def repeated(times: int) -> LampPoints:
        arrays = (getattr(one, name).expand(times, *getattr(one, name).shape[1:]) for name in ARRAYS)
        disc = turned_disc(times, one.normal)
        return LampPoints(*arrays, None, disc, torch.ones(disc.shape[:2], dtype=torch.bool))  # type: ignore[arg-type]

    disc = double(replace(LAMP, radius=torch.tensor(large)))
    found = shaded(repeated(400), disc, alpha, 0.5, 0.3, "dielectric").mean(dim=0)
    rng = np.random.default_rng(0)
    reach, angle = large * np.sqrt(rng.uniform(size=count)), 2 * np.pi * rng.uniform(size=count)
    shift = torch.from_numpy(np.stack([reach * np.cos(angle), reach * np.sin(angle), 0 * reach], axis=1))
    moved = repeated(count)
    moved = replace(moved, toward_camera=moved.toward_camera + shift)
    point = double(LAMP)
    torch.testing.assert_close(
        found, shaded(moved, point, alpha, 0.5, 0.3, "dielectric").mean(dim=0), rtol=5e-3, atol=0
    )
    single = shaded(one, point, alpha, 0.5, 0.3, "dielectric")[0]
    assert float((single / found - 1).abs().min()) > 0.05, "a point in the middle is another lamp"


def two_balls() -> Mesh:
    """A small ball before a large one, off the axis of the camera at `EYE`: the lamp throws its shadow."""
    large, small = icosphere(4), icosphere(4)
    middle = torch.tensor([0.45, 0.75, 1.6])
    positions = torch.cat([large.positions, 0.25 * small.positions + middle])
    return Mesh(positions, Topology(torch.cat([large.faces, small.faces + len(large.positions)])))


def scene(model: str, lamp: CameraLamp | None = LAMP) -> Scene:
    dark = EnvironmentMap(torch.full((8, 16, 3), 1e-6), lamp=lamp)
    color, alpha = torch.tensor([0.6, 0.5, 0.4]), torch.tensor([0.3])
    if model == "metallic":
        material = Material.metallic(color, torch.tensor([0.7]), alpha)
    else:
        material = Material(model, color, torch.full((3,), 0.2), alpha)  # type: ignore[arg-type]
    return Scene(two_balls(), material, dark)


def by_mitsuba(shown: Scene, size: int, samples: int) -> np.ndarray:
    """The picture by Mitsuba's own integrator and its own emitters; the BSDF alone is the project's."""
    mi = mitsuba_on("cpu")
    from hir_plugins.reflectance_renderers.mitsuba_ggx.ggx_bsdf import register

    register()
    camera, material = looking_at(EYE, size, size), shown.material
    assert material is not None
    given: dict[str, Any] = {"type": "hir_ggx", "model": material.model, "alpha": float(material.roughness)}
    rgb = {"diffuse_albedo": material.diffuse_albedo, "specular_albedo": material.specular_albedo}
    if material.model == "metallic":
        given["metalness"], rgb = float(material.metalness), {"base_color": material.base_color}  # type: ignore[arg-type]
    given |= {name: {"type": "rgb", "value": value.tolist()} for name, value in rgb.items()}
    rotation = camera.world_to_camera[:3, :3].astype(np.float64)
    props = mi.Properties()
    props["bsdf"] = mi.load_dict(given)
    mesh = mi.Mesh("balls", len(shown.mesh.positions), len(shown.mesh.faces), has_vertex_normals=True, props=props)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = shown.mesh.positions.numpy().ravel()
    parameters["vertex_normals"] = shown.mesh.normals.numpy().ravel()
    parameters["faces"] = shown.mesh.faces.numpy().astype(np.uint32).ravel()
    parameters.update()
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation.T @ np.diag([-1.0, -1.0, 1.0]), camera.center
    lamp = shown.environment.lamp if shown.environment is not None else None
    assert lamp is not None
    place = camera.center + rotation.T @ lamp.offset.double().numpy()
    radius = float(lamp.radius)
    emitter: dict[str, Any] = {
        "type": "point",
        "position": place.tolist(),
        "intensity": {"type": "rgb", "value": lamp.intensity.tolist()},
    }
    if radius > 0:
        # a disc of Mitsuba shines along +z; the one of the camera along its viewing axis, z of the rotation
        to_world = np.eye(4)
        to_world[:3, :3], to_world[:3, 3] = radius * rotation.T, place
        value = (lamp.intensity / (np.pi * radius**2)).tolist()
        light = {"type": "area", "radiance": {"type": "rgb", "value": value}}
        emitter = {"type": "disk", "to_world": mi.ScalarTransform4f(to_world), "emitter": light}
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    document = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2},
        "balls": mesh,
        "lamp": emitter,
        "sensor": {
            "type": "perspective",
            "fov": float(np.degrees(2 * np.arctan(size / 2 / camera.intrinsics[0, 0]))),
            "to_world": mi.ScalarTransform4f(pose),
            "film": film,
        },
    }
    return np.array(mi.render(mi.load_dict(document), spp=samples, seed=0))


@pytest.mark.slow
@pytest.mark.parametrize("radius", [0.0, 0.5])
@pytest.mark.parametrize("model", ["paper", "dielectric", "metallic"])
def test_both_renderers_agree_with_an_emitter_of_mitsuba(model: str, radius: float) -> None:
    """Direct light of a lamp, with the shadow of one ball on the other: of a point that shines equally in all
    directions, and of a disc, whose own surface is its lobe of emission."""
    size = 48
    exponent = torch.tensor(1.0 if radius else 0.0)
    shown = scene(model, replace(LAMP, exponent=exponent, radius=torch.tensor(radius)))
    samples = 1024 if radius else 256
    expected = by_mitsuba(shown, size, samples)
    torch.manual_seed(0)
    options = MitsubaGGXOptions(render_samples=samples, max_depth=2)
    traced = MitsubaGGX(options).render(shown, looking_at(EYE, size, size))
    cached = TransportGGX(TransportGGXOptions(vertices=0, cache_cells=200, supersampling=8)).render(
        shown, looking_at(EYE, size, size)
    )
    for picture in (traced, cached):
        # 0.7 %: the noise of 256 rays through each pixel at outlines, of both pictures; with a disc also 1 % in shadows
        assert relative_error(picture[..., :3].numpy(), expected) < (0.02 if radius else 0.01)
    lit = looking_at(EYE, size, size)
    without = TransportGGX(TransportGGXOptions(vertices=0, cache_cells=200)).render(scene(model, None), lit)
    assert float(without[..., :3].max()) < 1e-3


@pytest.mark.slow
def test_both_renderers_agree_on_the_lobe_of_emission() -> None:
    size, shown = 48, scene("dielectric")
    camera = looking_at(EYE, size, size)
    torch.manual_seed(0)
    traced = MitsubaGGX(MitsubaGGXOptions(render_samples=256, max_depth=2)).render(shown, camera)[..., :3].numpy()
    options = TransportGGXOptions(vertices=0, cache_cells=200, supersampling=8)
    cached = TransportGGX(options).render(shown, camera)[..., :3].numpy()
    assert relative_error(cached, traced) < 0.01
    even = TransportGGX(options).render(scene("dielectric", replace(LAMP, exponent=torch.tensor(0.0))), camera)
    assert relative_error(even[..., :3].numpy(), traced) > 0.02


def relative_error(picture: np.ndarray, expected: np.ndarray) -> float:
    """Sum of the absolute differences over that of the values."""
    return float(np.abs(picture - expected).sum() / expected.sum())


def test_a_lamp_at_the_camera_throws_no_visible_shadow() -> None:
    camera, shown = looking_at(EYE, 32, 32), scene("paper")
    surface = TransportGGX(TransportGGXOptions(vertices=0, cache_cells=200))._transport(shown)
    from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import visible_points

    grid = torch.tensor([(0, x, y) for y in range(32) for x in range(32)])
    seen, found = visible_points(surface.tracer, surface.surface, {0: camera}, grid)
    cameras = LampCameras.of({0: camera}, torch.device("cpu"))
    at = LampPoints.of(seen.take(found.nonzero()[:, 0]), cameras, surface.tracer, surface.offset)
    at.update_shadows(LAMP)
    assert 0.02 < 1 - float(at.lit.float().mean()) < 0.3, "the lamp beside the camera throws one"
    at.update_shadows(replace(LAMP, offset=torch.zeros(3)))
    assert bool(at.lit.all())
