"""The path tracer against quadrature, closed forms and Mitsuba's own integrator."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hir_exporters.conventions import direction_to_latlong_uv, latlong_directions, latlong_solid_angles
from hir_exporters.materials.brdf_numpy import dielectric_brdf, paper_brdf

from hir_core.capture import Camera, Capture, View
from hir_core.errors import StageError
from hir_core.scene import CameraLamp, EnvironmentMap, Material, Mesh, Scene, Topology
from hir_plugins.reflectance_renderers.mitsuba_ggx.options import MitsubaGGXOptions
from hir_plugins.reflectance_renderers.mitsuba_ggx.renderer import MitsubaGGX
from tests.fixtures.scenes import bumpy_sphere, icosphere, looking_at, square

AXES = {"+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1), "-z": (0, 0, -1)}
COLORS = {"+x": (1, 0, 0), "-x": (0, 1, 1), "+y": (0, 1, 0), "-y": (1, 0, 1), "+z": (0, 0, 1), "-z": (1, 1, 0)}


def material(model: str, diffuse: float, specular: float, alpha: float) -> Material:
    parts = torch.full((3,), float(diffuse)), torch.full((3,), float(specular)), torch.tensor([float(alpha)])
    return Material(model, *parts)  # type: ignore[arg-type]


def white(value: float = 1.0) -> EnvironmentMap:
    return EnvironmentMap(torch.full((8, 16, 3), value))


def uneven(height: int = 24, width: int = 48) -> EnvironmentMap:
    """Smooth, different in each direction, with a bright patch."""
    d = torch.from_numpy(latlong_directions(height, width)).float()
    bright = torch.exp(8 * ((d @ torch.tensor([0.5, 0.7, 0.5])) - 1))
    color = torch.stack([1 + d[..., 0], 1 + d[..., 1] * 0.8, 1 - 0.5 * d[..., 2]], -1)
    return EnvironmentMap(0.3 * color + 5 * bright[..., None])


def six_colors() -> EnvironmentMap:
    directions = latlong_directions(32, 64)
    names = list(AXES)
    nearest = np.argmax(directions @ np.array([AXES[n] for n in names]).T, axis=-1)
    return EnvironmentMap(torch.from_numpy(np.array([COLORS[n] for n in names], dtype=np.float32)[nearest]))


def capture_of(cameras: Sequence[Camera]) -> Capture:
    return Capture(Path("none"), tuple(View(str(i), c, read=None) for i, c in enumerate(cameras)))  # type: ignore[arg-type]


def renderer(**options: int) -> MitsubaGGX:
    return MitsubaGGX(MitsubaGGXOptions(**options))


def center_pixels(views: int, size: int) -> torch.Tensor:
    return torch.tensor([[view, size // 2, size // 2] for view in range(views)])


# -- paths that end -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lamp", [False, True])
def test_dropping_paths_that_have_ended_changes_no_value(lamp: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two spheres that reflect each other, four reflections: each sample has the value that it has among all."""
    from hir_plugins.reflectance_renderers.mitsuba_ggx import prepared_scene

    ball = icosphere(4)
    positions = torch.cat([ball.positions - torch.tensor([1.05, 0, 0]), ball.positions + torch.tensor([1.05, 0, 0])])
    mesh = Mesh(positions, Topology(torch.cat([ball.faces, ball.faces + len(ball.positions)])))
    light = uneven()
    if lamp:
        light = replace(light, lamp=CameraLamp(torch.full((3,), 9.0), torch.zeros(3), torch.tensor(1.0)))
    scene = Scene(mesh, material("dielectric", 0.9, 0.3, 0.2), light)
    camera = looking_at((0, 0.5, 6), 64, 64)
    prepared = renderer(max_depth=5).prepare(scene, capture_of([camera]))
    pixels = torch.cartesian_prod(torch.tensor([0]), torch.arange(10, 54), torch.arange(10, 54))
    assert scene.material is not None
    dropped = prepared.trace(scene.material, light, pixels, 4, 7)
    plain = prepared_scene.incoming
    monkeypatch.setattr(prepared_scene, "incoming", lambda *arguments: plain(*arguments[:-1], False))
    whole = prepared.trace(scene.material, light, pixels, 4, 7)
    assert torch.equal(dropped.color, whole.color) and torch.equal(dropped.coverage, whole.coverage)
    direct = renderer(max_depth=3).prepare(scene, capture_of([camera])).trace(scene.material, light, pixels, 4, 7)
    assert float((whole.color - direct.color).mean()) > 1e-3, "later reflections matter here"


def test_another_number_of_pixels_compiles_no_kernel() -> None:
    """Views have different numbers of pixels, and a kernel takes seconds."""
    import drjit as dr

    scene = Scene(bumpy_sphere(3), material("dielectric", 0.9, 0.3, 0.2), white())
    prepared = renderer(max_depth=5).prepare(scene, capture_of([looking_at((0, 0.5, 4), 64, 64)]))
    pixels = torch.cartesian_prod(torch.tensor([0]), torch.arange(20, 44), torch.arange(20, 44))
    assert scene.material is not None
    threads = dr.thread_count()
    dr.set_thread_count(2)  # with one there is no such kernel
    try:
        prepared.trace(scene.material, white(), pixels, 8, 1)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            prepared.trace(scene.material, white(), pixels[:-37], 8, 1)
            kernels = [each for each in dr.kernel_history() if "cache_hit" in each]
    finally:
        dr.set_thread_count(threads)
    assert kernels and all(each["cache_hit"] for each in kernels)


def test_paths_that_all_leave_at_once() -> None:
    """A square reflects nothing onto itself: no path is left after the first reflection."""
    scene = Scene(square(), material("dielectric", 0.5, 0.04, 0.3), white())
    camera = looking_at((0, 3, 0.5), 32, 32)
    pixels = center_pixels(1, 32)
    assert scene.material is not None
    many, two = (
        renderer(max_depth=depth).prepare(scene, capture_of([camera])).trace(scene.material, white(), pixels, 64, 1)
        for depth in (5, 2)
    )
    assert float(many.color.mean()) > 0.1 and torch.equal(many.color, two.color)


# -- value ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("model", "formula"), [("paper", paper_brdf), ("dielectric", dielectric_brdf)])
@pytest.mark.parametrize("alpha", [0.08, pytest.param(0.4, marks=pytest.mark.slow)])
def test_sphere_is_the_quadrature_of_the_rendering_equation(model: str, formula, alpha: float) -> None:  # type: ignore[no-untyped-def]
    """Direct light on a sphere, from the middle to the rim, within 4 standard errors and those below 1 %."""
    light, camera = uneven(), looking_at((0, 0.5, 4), 512, 512)
    pixels = torch.tensor([[0, 256, 256], [0, 300, 200], [0, 200, 330], [0, 330, 330], [0, 256, 104]])
    scene = Scene(icosphere(5), material(model, 0.6, 0.3, alpha), light)
    prepared = renderer(samples=1024, max_depth=2).prepare(scene, capture_of([camera]))
    torch.manual_seed(0)
    runs = torch.stack([prepared.radiance(scene.material, light, pixels) for _ in range(16)])  # type: ignore[arg-type]
    mean, error = runs.mean(0).numpy(), runs.std(0).numpy() / 4

    origin, direction = camera.rays(pixels[:, 1:].numpy() + 0.5)
    reach = -(origin * direction).sum(1) - np.sqrt((origin * direction).sum(1) ** 2 - (origin**2).sum(1) + 1)
    normal = origin + reach[:, None] * direction
    expected = np.stack([quadrature(light, n, -d, formula, alpha) for n, d in zip(normal, direction, strict=True)])
    assert (error < 0.01 * expected).all()
    # 0.5 %: the facets of the sphere and the extent of the pixel
    assert (np.abs(mean - expected) < 4 * error + 0.005 * expected).all()


def quadrature(light: EnvironmentMap, normal, eye, formula, alpha: float):  # type: ignore[no-untyped-def]
    """Integral of light · f · cos over a fine lat-long grid, the light interpolated as docs/conventions.md says."""
    height = 512
    directions = latlong_directions(height, 2 * height).reshape(-1, 3)
    weights = np.repeat(latlong_solid_angles(height, 2 * height), 2 * height)
    radiance = light.radiance.numpy().astype(np.float64)
    rows, columns = radiance.shape[:2]
    u, v = direction_to_latlong_uv(directions).T
    x, y = u * columns - 0.5, v * rows - 0.5
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    s, t = (x - i)[:, None], (y - j)[:, None]

    def texel(row, column):  # type: ignore[no-untyped-def]
        return radiance[np.clip(row, 0, rows - 1), column % columns]

    incident = (texel(j, i) * (1 - s) + texel(j, i + 1) * s) * (1 - t) + (
        texel(j + 1, i) * (1 - s) + texel(j + 1, i + 1) * s
    ) * t
    helper = np.array([1.0, 0, 0]) if abs(normal[0]) < 0.9 else np.array([0, 1.0, 0])
    tangent = np.cross(helper, normal)
    tangent /= np.linalg.norm(tangent)
    frame = np.stack([tangent, np.cross(normal, tangent), normal])
    wi, wo = directions @ frame.T, frame @ eye
    value = formula(wi, np.broadcast_to(wo, wi.shape), [0.6] * 3, [0.3] * 3, alpha)
    return (incident * value * (np.maximum(wi[:, 2:], 0) * weights[:, None])).sum(axis=0)


@pytest.mark.parametrize("alpha", [1e-3, 0.1, 1.0])
@pytest.mark.parametrize("specular", [0.0, 0.04, 1.0])
def test_white_furnace(alpha: float, specular: float) -> None:
    """A white coupled dielectric equals its white surround; the paper's model never exceeds it."""
    sphere, camera = icosphere(4), looking_at((0, 0, 4), 32, 32)
    trace = renderer(render_samples=256)
    torch.manual_seed(0)
    image = trace.render(Scene(sphere, material("dielectric", 1, specular, alpha), white()), camera)
    inside = image[..., 3] == 1
    assert float(image[..., :3][inside].mean()) == pytest.approx(1, abs=4e-3)
    image = trace.render(Scene(sphere, material("paper", 1 - specular, specular, alpha), white()), camera)
    assert float(image[..., :3][inside].mean()) < 1 + 4e-3


def test_energy_in_a_concave_object_grows_with_depth_and_stays_below_one() -> None:
    scene = Scene(bumpy_sphere(4), material("dielectric", 1, 0.04, 0.3), white())
    means = []
    for depth in (2, 3, 6):
        torch.manual_seed(0)
        image = renderer(max_depth=depth, render_samples=64).render(scene, looking_at((0, 0, 4), 32, 32))
        means.append(float(image[..., :3].sum() / image[..., 3:].sum() / 3))
    assert means[0] < means[1] < means[2] < 1 + 1e-3
    assert means[2] > 0.98


@pytest.mark.parametrize("axis", list(AXES))
def test_mirror_shows_the_axis_it_faces(axis: str) -> None:
    """From +x a mirror ball reflects +x; with a rotated light, the colour that is then there."""
    trace, eye = renderer(render_samples=32, max_depth=2), tuple(4.0 * c for c in AXES[axis])
    scene = Scene(icosphere(4), material("paper", 0, 1, 0.02), six_colors())
    image = trace.render(scene, looking_at(eye, 33, 33))  # type: ignore[arg-type]
    np.testing.assert_allclose(image[16, 16, :3], COLORS[axis], atol=0.05)
    turn = torch.tensor([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # x → y → z → x
    turned = replace(scene, environment=replace(scene.environment, to_world=turn))  # type: ignore[type-var]
    image = trace.render(turned, looking_at(eye, 33, 33))  # type: ignore[arg-type]
    came_from = next(n for n, d in AXES.items() if np.allclose(turn.numpy() @ np.array(d), AXES[axis]))
    np.testing.assert_allclose(image[16, 16, :3], COLORS[came_from], atol=0.05)


def test_light_of_the_camera_travels_with_it() -> None:
    """A mirror reflects what is behind the camera, −z in its axes, in all views of one batch."""
    light = replace(six_colors(), frame="camera")
    cameras = [looking_at(tuple(4.0 * c for c in d), 33, 33) for d in AXES.values()]  # type: ignore[arg-type]
    scene = Scene(icosphere(4), material("paper", 0, 1, 0.02), light)
    prepared = renderer(samples=64, max_depth=2).prepare(scene, capture_of(cameras))
    colors = prepared.radiance(scene.material, light, center_pixels(6, 33))  # type: ignore[arg-type]
    np.testing.assert_allclose(colors, np.tile(COLORS["-z"], (6, 1)), atol=0.05)


def test_agrees_with_mitsubas_own_path_integrator() -> None:
    """The BSDF as a plugin under Mitsuba's `path` and `envmap`: another loop, another light, the same pictures.

    Mitsuba puts the first and last row of a light onto the poles, we half a row beside them: hence a fine light.
    """
    from hir_plugins.reflectance_renderers.mitsuba_variant import mitsuba_on

    mi = mitsuba_on("cpu")
    from hir_plugins.reflectance_renderers.mitsuba_ggx.ggx_bsdf import register

    register()
    mesh, camera, light = bumpy_sphere(4), looking_at((0, 0.5, 4), 24, 24), uneven(256, 512)
    props = mi.Properties()
    props["bsdf"] = mi.load_dict(
        {
            "type": "hir_ggx",
            "model": "dielectric",
            "diffuse_albedo": {"type": "rgb", "value": 0.7},
            "specular_albedo": {"type": "rgb", "value": 0.1},
            "alpha": 0.25,
        }
    )
    shape = mi.Mesh("s", len(mesh.positions), len(mesh.faces), props, has_vertex_normals=True)
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mesh.positions.numpy().ravel()
    parameters["vertex_normals"] = mesh.normals.numpy().ravel()
    parameters["faces"] = mesh.faces.numpy().astype(np.uint32).ravel()
    parameters.update()
    to_world = mi.ScalarTransform4f(np.linalg.inv(camera.world_to_camera) @ np.diag([-1, -1, 1, 1]))
    scene = mi.load_dict(
        {
            "type": "scene",
            "shape": shape,
            "light": {"type": "envmap", "bitmap": mi.Bitmap(light.radiance.numpy())},
            "sensor": {
                "type": "perspective",
                "fov": 2 * math.degrees(math.atan(0.5 / 1.5)),
                "fov_axis": "x",
                "to_world": to_world,
                "film": {
                    "type": "hdrfilm",
                    "width": 24,
                    "height": 24,
                    "rfilter": {"type": "box"},
                    "pixel_format": "rgba",
                },
            },
        }
    )
    path = mi.load_dict({"type": "path", "max_depth": 3, "hide_emitters": True})
    theirs, again = (np.array(mi.render(scene, integrator=path, spp=1024, seed=seed)) for seed in (0, 1))
    torch.manual_seed(0)
    surface_material = material("dielectric", 0.7, 0.1, 0.25)
    ours = renderer(render_samples=1024).render(Scene(mesh, surface_material, light), camera).numpy()
    np.testing.assert_allclose(ours[..., 3], theirs[..., 3], atol=0.04)
    assert abs(ours[..., :3].mean() / theirs[..., :3].mean() - 1) < 3e-3
    inside = ours[..., 3] == 1
    noise = np.abs(theirs - again)[inside].mean()
    assert noise < 0.03 * theirs[inside].mean()
    assert np.abs(ours - (theirs + again) / 2)[inside].mean() < noise


def test_coverage_is_antialiased_and_its_own() -> None:
    """The area of a sphere's silhouette in pixels, and fractions only at its edge."""
    camera = looking_at((0, 0, 4), 64, 56)
    image = renderer(render_samples=64).render(Scene(icosphere(5), material("paper", 0.5, 0, 1), white()), camera)
    assert image.shape == (56, 64, 4)
    radius = 1.5 * 64 * math.tan(math.asin(1 / 4))
    assert float(image[..., 3].sum()) == pytest.approx(math.pi * radius**2, rel=3e-3)
    partly = (image[..., 3] > 0) & (image[..., 3] < 1)
    assert 0.5 < int(partly.sum()) / (2 * math.pi * radius) < 2
    assert bool((image[..., :3][image[..., 3] == 0] == 0).all())
    seen = image[..., 3] > 0
    color = image[..., :3][seen] / image[..., 3:][seen]
    rim = image[..., 3][seen] < 1
    assert float(color[~rim].mean()) == pytest.approx(0.5, abs=5e-3)
    assert float(color[rim].mean()) == pytest.approx(0.5, abs=0.03)  # premultiplied: no dark rim


@pytest.mark.parametrize(("scale", "shift"), [(1e-3, 0.0), (1e4, 0.0), (0.05, 3.0)])
def test_scale_and_position_do_not_matter(scale: float, shift: float) -> None:
    """An object of a millimetre far from the origin is rendered like the same object of radius 1 at the origin."""
    mesh, camera = bumpy_sphere(3), looking_at((1, 2, 3), 24, 24)
    similarity = np.diag([scale, scale, scale, 1.0])
    similarity[:3, 3] = shift
    moved = mesh.with_positions(mesh.positions * scale + shift)
    surface_material, light = material("dielectric", 0.5, 0.04, 0.3), uneven()
    trace = renderer(render_samples=64)
    torch.manual_seed(0)
    there = trace.render(Scene(moved, surface_material, light), camera.transformed(similarity))
    torch.manual_seed(0)
    here = trace.render(Scene(mesh, surface_material, light), camera)
    assert float((there - here).abs().mean()) < 1e-3


@pytest.mark.parametrize("model", ["paper", "dielectric"])
def test_hard_values_stay_finite(model: str) -> None:
    """Black, white, mirrors and a sun, in value and derivative."""
    sun = torch.full((16, 32, 3), 0.1)
    sun[4, 31] = 1e4
    mesh, cameras = bumpy_sphere(3), [looking_at((0, 0, 4), 16, 16)]
    y, x = torch.meshgrid(torch.arange(16), torch.arange(16), indexing="ij")
    pixels = torch.stack([torch.zeros_like(x), x, y], -1).reshape(-1, 3)
    for light in (sun, torch.zeros(16, 32, 3)):
        for diffuse, specular, alpha in ((0, 0, 1e-4), (1, 1, 1e-3), (0.5, 0.04, 1.0), (0, 1, 1e-4)):
            surface_material = material(model, diffuse, specular, alpha)
            leaves = [
                surface_material.diffuse_albedo,
                surface_material.specular_albedo,
                surface_material.roughness,
                light.clone(),
            ]
            for leaf in leaves:
                leaf.requires_grad_()
            prepared = renderer(samples=16).prepare(Scene(mesh), capture_of(cameras))
            value = prepared.radiance(surface_material, EnvironmentMap(leaves[3]), pixels)
            assert torch.isfinite(value).all()
            assert (value >= 0).all()
            for gradient in torch.autograd.grad(value.sum(), leaves):
                assert torch.isfinite(gradient).all()


# -- derivative -----------------------------------------------------------------------------------------------------


def textured(model: str) -> tuple[Mesh, Material, EnvironmentMap]:
    torch.manual_seed(1)
    maps = 0.2 + 0.6 * torch.rand(8, 8, 3), 0.05 + 0.3 * torch.rand(4, 4, 3), 0.2 + 0.3 * torch.rand(4, 4, 1)
    surface_material = Material(model, *maps)  # type: ignore[arg-type]
    mesh = bumpy_sphere(3)
    uvs = torch.from_numpy(direction_to_latlong_uv(mesh.positions.numpy())).float()
    return replace(mesh, uvs=uvs, topology=Topology(mesh.faces, mesh.faces)), surface_material, uneven(8, 16)


@pytest.mark.parametrize(
    ("name", "model"),
    [
        *(
            (name, model)
            for name in ("diffuse_albedo", "specular_albedo", "radiance")
            for model in ("paper", "dielectric")
        ),
        ("roughness", "dielectric"),
        pytest.param("roughness", "paper", marks=pytest.mark.slow),
    ],
)
def test_derivative_matches_central_differences(model: str, name: str) -> None:
    """Along a direction: the difference of both estimates is known to 2 % and lies within 4 standard errors."""
    mesh, surface_material, light = textured(model)
    # α moves the samples themselves, which leaves more noise in the differences
    samples = 1024 if name == "roughness" else 256
    prepared = renderer(samples=samples).prepare(Scene(mesh), capture_of([looking_at((0, 1, 4), 24, 24)]))
    y, x = torch.meshgrid(torch.arange(6, 18), torch.arange(6, 18), indexing="ij")
    pixels = torch.stack([torch.zeros_like(x), x, y], -1).reshape(-1, 3)
    weights = torch.rand(len(pixels), 3, generator=torch.Generator().manual_seed(2))
    start = light.radiance if name == "radiance" else getattr(surface_material, name)
    direction = 0.5 + torch.rand(start.shape, generator=torch.Generator().manual_seed(3))

    def value(at: torch.Tensor) -> torch.Tensor:
        there = surface_material if name == "radiance" else replace(surface_material, **{name: at})
        sky = EnvironmentMap(at) if name == "radiance" else light
        return (prepared.radiance(there, sky, pixels) * weights).sum()

    analytic, numeric, step = [], [], 0.05 if name == "roughness" else 0.02
    for seed in range(12):
        torch.manual_seed(seed)
        leaf = start.clone().requires_grad_()
        analytic.append(float((torch.autograd.grad(value(leaf), leaf)[0] * direction).sum()))
        with torch.no_grad():
            # the same random numbers on both sides: their noise cancels
            torch.manual_seed(seed)
            above = value(start + step * direction)
            torch.manual_seed(seed)
            numeric.append(float(above - value(start - step * direction)) / (2 * step))
    error = math.hypot(np.std(analytic), np.std(numeric)) / math.sqrt(11)
    assert error < 0.02 * abs(np.mean(numeric))
    assert abs(np.mean(analytic) - np.mean(numeric)) < 4 * error + 0.002 * abs(np.mean(numeric))


def test_black_albedo_has_the_derivative_of_its_irradiance() -> None:
    """In a white surround d(radiance)/d(ρd) = 1 for a convex body, also where its albedo is 0."""
    surface_material = material("paper", 0, 0, 0.3)
    surface_material.diffuse_albedo.requires_grad_()
    prepared = renderer(samples=256).prepare(Scene(icosphere(4)), capture_of([looking_at((0, 0, 4), 16, 16)]))
    value = prepared.radiance(surface_material, white(), torch.tensor([[0, 8, 8], [0, 7, 6]]))
    gradient = torch.autograd.grad(value.mean(0).sum(), surface_material.diffuse_albedo)[0]
    np.testing.assert_allclose(gradient, 1, atol=0.02)


def test_derivative_uses_independent_samples() -> None:
    """Σ (y − t)² with noisy y: with the value's own samples the gradient would be biased by the variance."""
    surface_material, light = material("paper", 0.5, 0, 1), uneven()
    capture = capture_of([looking_at((0, 0, 4), 16, 16)])
    prepared = renderer(samples=1, gradient_samples=1).prepare(Scene(icosphere(3)), capture)
    pixels = torch.tensor([[0, x, y] for x in range(6, 10) for y in range(6, 10)])
    torch.manual_seed(0)
    exact = torch.stack([prepared.radiance(surface_material, light, pixels) for _ in range(100)]).mean(0)
    slopes = []
    for _ in range(100):
        albedo = torch.full((3,), 0.5, requires_grad=True)
        value = prepared.radiance(replace(surface_material, diffuse_albedo=albedo), light, pixels)
        loss = (value - exact).square().sum()
        slopes.append(float(torch.autograd.grad(loss, albedo)[0].sum()))
    # at the optimum the expected gradient is zero
    assert abs(np.mean(slopes)) < 4 * np.std(slopes) / math.sqrt(100)


def test_steps_do_not_compile_again() -> None:
    """After the first step every kernel comes from the cache, for any seed, batch and values."""
    import drjit as dr

    mesh, surface_material, light = textured("dielectric")
    cameras = [looking_at((0, 1, 4), 24, 24), looking_at((4, 1, 0), 24, 24)]
    prepared = renderer(samples=8).prepare(Scene(mesh), capture_of(cameras))
    albedo = surface_material.diffuse_albedo.clone().requires_grad_()
    dr.set_flag(dr.JitFlag.KernelHistory, True)
    try:
        misses = []
        for step in range(6):
            pixels = torch.stack(
                [
                    torch.randint(0, 2, (300 + step,)),
                    torch.randint(0, 24, (300 + step,)),
                    torch.randint(0, 24, (300 + step,)),
                ],
                1,
            )
            prepared.radiance(replace(surface_material, diffuse_albedo=albedo * 0.9), light, pixels).sum().backward()
            misses.append(sum(kernel.get("cache_hit") == 0 for kernel in dr.kernel_history()))
    finally:
        dr.set_flag(dr.JitFlag.KernelHistory, False)
    assert misses[1:] == [0] * 5


# -- normal maps, errors --------------------------------------------------------------------------------------------


def test_normal_map_has_the_axes_of_gltf() -> None:
    """Red is +u, green is up in the texture (−v): a lit floor is brighter where its normal points towards the light."""
    d = torch.from_numpy(latlong_directions(16, 32)).float()
    camera = looking_at((0, 4, 0), 16, 16)

    def brightness(vector: tuple[float, float, float], axis: int) -> float:
        light = EnvironmentMap((d[..., axis : axis + 1] > 0.5).float().expand(-1, -1, 3).contiguous())
        normal = torch.nn.functional.normalize(torch.tensor(vector, dtype=torch.float32), dim=0)
        normal = normal.expand(4, 4, 3).contiguous()
        scene = Scene(square(), replace(material("paper", 0.8, 0, 1), normal=normal), light)
        torch.manual_seed(0)
        return float(renderer(render_samples=64).render(scene, camera)[8, 8, 0])

    flat = brightness((0, 0, 1), 0)
    assert brightness((0.4, 0, 1), 0) > 1.3 * flat  # u runs along +x
    assert brightness((-0.4, 0, 1), 0) < 0.7 * flat
    flat = brightness((0, 0, 1), 2)
    assert brightness((0, -0.4, 1), 2) > 1.3 * flat  # v runs along +z, so green up is −z
    assert brightness((0, 0.4, 1), 2) < 0.7 * flat


def test_wrong_input_is_named() -> None:
    camera = looking_at((0, 0, 4), 8, 8)
    with pytest.raises(StageError, match="needs a material"):
        renderer().render(Scene(icosphere(1)), camera)
    surface_material = Material("paper", torch.rand(4, 4, 3), torch.zeros(3), torch.ones(1))
    with pytest.raises(StageError, match="no texture coordinates"):
        renderer().render(Scene(icosphere(1), surface_material, white()), camera)
    empty = Mesh(torch.zeros(0, 3), Topology(torch.zeros(0, 3, dtype=torch.long)))
    with pytest.raises(StageError, match="empty"):
        renderer().render(Scene(empty, material("paper", 1, 0, 1), white()), camera)
