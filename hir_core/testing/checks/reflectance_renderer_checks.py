"""Contracts of reflectance renderers: energy, reciprocity, linearity, gradients, agreement with the reference."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from hir_core.testing.checks.reflectance_samples import FEW, MANY, SIZE, capture_of, mean_over_seeds, pixel_grid
from hir_core.testing.contract import NotApplicable, Subject, contract, require
from hir_core.testing.exercise import Exercise, seeded

if TYPE_CHECKING:
    from torch import Tensor

    from hir_core.capture import Camera
    from hir_core.plugins.interfaces import PreparedReflectance, ReflectanceRenderer
    from hir_core.scene import EnvironmentMap, Material, Mesh, Scene


def _scene(material: Material, light: EnvironmentMap, mesh: Mesh | None = None) -> Scene:
    from hir_core.scene import Scene
    from hir_core.testing.scenes import smooth_sphere

    return Scene(mesh or smooth_sphere(4), material, light)


def _prepared(subject: Subject, scene: Scene, camera: Camera) -> PreparedReflectance:
    found: PreparedReflectance = subject.create().prepare(scene, capture_of([camera]))
    return found


def _mean_of(radiance: Callable[[], Tensor]) -> Tensor:
    return radiance().mean(0)


def exercise(subject: Subject, device: str) -> Exercise:
    """Radiance of a glossy sphere under an uneven light, and a picture of it."""
    from hir_core.testing.scenes import constant_material, looking_at, uneven_light

    scene = _scene(constant_material("dielectric", 0.4, 0.04, 0.3), uneven_light(16)).to(device)
    camera = looking_at((0, 1, 4), SIZE)
    capture = capture_of([camera])

    def run() -> dict[str, np.ndarray]:
        renderer = subject.create()
        assert scene.material is not None and scene.environment is not None
        pixels = pixel_grid(step=2).to(device)
        shown = renderer.prepare(scene, capture).radiance(scene.material, scene.environment, pixels)
        picture = renderer.render(scene, camera)
        return {"radiance": shown.detach().cpu().numpy(), "picture": picture.detach().cpu().numpy()}

    return Exercise({"scene": scene, "cameras": capture.cameras}, run)


@contract("reflectance_renderer", first=True, slow=True)
def radiance_is_finite_and_in_place(subject: Subject) -> None:
    """`radiance` gives (pixels, 3), finite, not negative, 0 where a pixel misses; `render` gives (height, width, 4)
    with premultiplied colour and coverage in 0…1; both show the same.
    """
    import torch

    from hir_core.testing.scenes import constant_material, looking_at, uneven_light

    light, camera = uneven_light(16), looking_at((0, 1, 4), SIZE)
    material = constant_material("dielectric", 0.4, 0.04, 0.4)
    scene = _scene(material, light)
    pixels = pixel_grid()
    prepared = _prepared(subject, scene, camera)
    shown, _ = mean_over_seeds(subject, lambda: prepared.radiance(material, light, pixels))
    require(
        tuple(shown.shape) == (len(pixels), 3),
        f"radiance of {len(pixels)} pixels has the shape {tuple(shown.shape)}; ({len(pixels)}, 3) is needed",
    )
    beside = ~torch.isfinite(shown).all(1) & ~_shows_the_ball(pixels, camera)
    require(
        not beside.any(),
        f"radiance is not finite in {int(beside.sum())} pixels that show no object; give 0 there, by torch.where after "
        "what divides by 0 was clamped: a NaN of the other branch would stay in the gradient",
    )
    require(torch.isfinite(shown).all(), f"{int((~torch.isfinite(shown)).sum())} values of radiance are not finite")
    require(
        float(shown.min()) >= 0,
        f"radiance goes from {float(shown.min()):.4g} to {float(shown.max()):.4g}",
    )
    image = shown.reshape(SIZE, SIZE, 3)
    require(float(image[1, 1].max()) == 0, f"a pixel beside the object has the radiance {image[1, 1].tolist()}")
    seeded(0)
    picture = subject.create().render(scene, camera)
    require(tuple(picture.shape) == (SIZE, SIZE, 4), f"render gives the shape {tuple(picture.shape)}")
    require(torch.isfinite(picture).all(), "render gives values that are not finite")
    coverage = picture[..., 3]
    require(float(coverage.min()) >= 0 and float(coverage.max()) <= 1 + 1e-6, "coverage leaves 0…1")
    require(
        float(coverage[1, 1]) == 0 and float(coverage[SIZE // 2, SIZE // 2]) > 0.99,
        f"coverage is {float(coverage[1, 1]):.3g} beside the object, {float(coverage[SIZE // 2, SIZE // 2]):.3g} on it",
    )
    inside = coverage > 0.99
    difference = float((picture[..., :3][inside].double() - image[inside].double()).abs().mean() / image[inside].mean())
    require(difference < 0.06, f"inside the object render and radiance differ by {100 * difference:.1f} % on average")


def _shows_the_ball(pixels: Tensor, camera: Camera) -> Tensor:
    """Whether the middle of each pixel (B, 3) of one camera shows a sphere of radius 1 at the origin."""
    import torch

    return torch.from_numpy(np.isfinite(_ball_normals(pixels, [camera])).all(axis=1))


def _ball_normals(pixels: Tensor, cameras: Sequence[Camera]) -> np.ndarray:
    """Normals (B, 3) of a sphere of radius 1 at the origin in pixels (B, 3): view, x, y; NaN beside the sphere."""
    normals = np.full((len(pixels), 3), np.nan)
    for i, camera in enumerate(cameras):
        chosen = (pixels[:, 0] == i).numpy()
        origin, direction = camera.rays(pixels[chosen, 1:].numpy() + 0.5)
        half = (origin * direction).sum(axis=1)
        root = half**2 - (origin**2).sum(axis=1) + 1
        reach = -half - np.sqrt(np.where(root > 0, root, np.nan))
        normals[chosen] = origin + reach[:, None] * direction
    return normals


@contract("reflectance_renderer", slow=True)
def white_furnace(subject: Subject) -> None:
    """Under a light of 1 from everywhere a white diffuse sphere cannot be told from it (1 %), a white coupled
    dielectric neither (2 %), and no material of the `paper` model with ρd + ρs ≤ 1 is brighter than the light. Of a
    renderer with the trait `lambertian` the diffuse sphere alone is tested.
    """
    import torch

    from hir_core.scene import EnvironmentMap
    from hir_core.testing.scenes import constant_material, looking_at

    white, camera = EnvironmentMap(torch.ones(32, 64, 3)), looking_at((0, 0, 4), SIZE)
    pixels = pixel_grid()[(SIZE // 2) * SIZE + SIZE // 2 - 5 : (SIZE // 2) * SIZE + SIZE // 2 + 5]
    cases = [("white and diffuse", constant_material("paper", 1.0, 0.0, 0.5), 0.99, 1.01)]
    for alpha in () if subject.has("lambertian") else (0.1, 0.5):
        cases.append(
            (f"a white dielectric of ρs 0.3, α {alpha:g}", constant_material("dielectric", 1.0, 0.3, alpha), 0.98, 1.02)
        )
        cases.append(
            (f"`paper` with ρd = ρs = 0.5, α {alpha:g}", constant_material("paper", 0.5, 0.5, alpha), 0.5, 1.01)
        )
    prepared = _prepared(subject, _scene(cases[0][1], white), camera)
    for name, material, low, high in cases:
        radiance = partial(prepared.radiance, material, white, pixels)
        shown, error = mean_over_seeds(subject, partial(_mean_of, radiance))
        slack = 4 * float(error.max())
        found = float(shown.mean())
        require(
            low - slack <= found <= high + slack,
            f"under a light of 1, {name} shows {found:.4f}; it must lie in {low:g} … {high:g}"
            + _factor(found, low, high),
        )


def _factor(found: float, low: float, high: float) -> str:
    """Advice for a value that is a factor away from its range; empty for one that is near it."""
    if found > 1.5 * high:
        return f"; it is {found / high:.1f} times too bright: look for a missing division or a factor π"
    if 0 < 1.5 * found < low:
        return f"; it is {low / found:.1f} times too dark: look for a division too many or a missing factor π"
    return ""


@contract("reflectance_renderer", unless={"lambertian"}, slow=True)
def reciprocity(subject: Subject) -> None:
    """Light from A seen from B reflects like light from B seen from A: the lobe of a rough plane, light and eye
    exchanged, agrees within 4 %.
    """
    import torch

    from hir_core.scene import EnvironmentMap
    from hir_core.testing.scenes import constant_material, looking_at, plane

    a, b = (_elevated(azimuth, polar) for azimuth, polar in ((0.4, 20.0), (1.6, 55.0)))
    lobe, lambertian = constant_material("paper", 0.0, 0.5, 0.6), constant_material("paper", 1.0, 0.0, 0.6)
    ratios = []
    for source, eye in ((a, b), (b, a)):
        light = EnvironmentMap(_spot(source, 64))
        camera = looking_at(tuple(4 * eye), SIZE)
        prepared = _prepared(subject, _scene(lobe, light, plane(2.0, 8)), camera)
        middle = pixel_grid()[(SIZE // 2 - 2) * SIZE : (SIZE // 2 + 2) * SIZE]
        middle = middle[(middle[:, 1] - SIZE // 2).abs() < 3]

        def middle_of(
            material: Material, p: PreparedReflectance = prepared, lit: EnvironmentMap = light, at: Tensor = middle
        ) -> Tensor:
            found: Tensor = p.radiance(material, lit, at).mean()
            return found

        shown, shown_error = mean_over_seeds(subject, partial(middle_of, lobe), MANY)
        whole, _ = mean_over_seeds(subject, partial(middle_of, lambertian), MANY)
        # a Lambertian plane shows the irradiance over π, whatever the side it is seen from
        ratios.append((float(shown / whole), float(shown_error / whole)))
    (there, error_there), (back, error_back) = ratios
    slack = 4 * float(np.hypot(error_there, error_back)) / back
    require(
        abs(there / back - 1) <= 0.04 + slack, f"π times the lobe is {there:.4f} from A to B and {back:.4f} from B to A"
    )
    require(there > 0 and torch.isfinite(torch.tensor(there)), f"the lobe shows {there}")


def _elevated(azimuth: float, polar_degrees: float) -> np.ndarray:
    polar = np.radians(polar_degrees)
    return np.array([np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)])


def _spot(direction: np.ndarray, rows: int, sharpness: float = 150.0) -> Tensor:
    """A lobe of light around a direction: 5° wide (standard deviation), or 13° with a sharpness of 20."""
    import torch
    from hir_exporters.conventions import latlong_directions

    cosine = latlong_directions(rows, 2 * rows) @ direction
    return torch.from_numpy(np.exp(sharpness * (cosine - 1)))[..., None].expand(-1, -1, 3).float().contiguous()


@contract("reflectance_renderer", slow=True)
def light_has_its_frame(subject: Subject) -> None:
    """A diffuse sphere is brightest where it faces the light: in each of two views, for a light of the world, for one
    with `EnvironmentMap.to_world`, which rotates the axes of the map to those of the world, and for one with the frame
    `camera`, whose axes are those of each camera. The radiance correlates with max(0, n·ω) by 0.95 or more.
    """
    import torch

    from hir_core.scene import EnvironmentMap
    from hir_core.testing.scenes import constant_material, looking_at, smooth_sphere

    cameras = [looking_at((1.5, 2.0, -4.0), SIZE), looking_at((-3.5, 1.0, 2.5), SIZE)]
    material = constant_material("paper", 0.7, 0.0, 0.5)
    pixels = torch.cat([pixel_grid() + torch.tensor([i, 0, 0]) for i in range(len(cameras))])
    normals = _ball_normals(pixels, cameras)
    inside = np.isfinite(normals).all(axis=1)
    pixels, normals = pixels[torch.from_numpy(inside)], normals[inside]
    view = pixels[:, 0].numpy()
    in_camera = np.stack([camera.world_to_camera[:3, :3] for camera in cameras])[view]
    turn = np.linalg.qr(np.array([[0.2, -0.7, 0.5], [0.9, 0.3, 0.1], [-0.1, 0.6, 0.8]]))[0]
    turn *= np.sign(np.linalg.det(turn))
    for of_world in (True, False):
        for turned in (False, True):
            # both of these, taken for directions of the world, light what one of the cameras sees
            target = np.array([-0.3, 0.75, 0.59]) if of_world else np.array([0.45, -0.5, -0.74])
            in_map = turn.T @ target if turned else target
            light = EnvironmentMap(
                _spot(in_map / np.linalg.norm(in_map), 32, 20.0),
                torch.from_numpy(turn).float() if turned else None,
                "world" if of_world else "camera",
            )
            scene = _scene(material, light, smooth_sphere(3))
            prepared = subject.create().prepare(scene, capture_of(cameras))
            shown, _ = mean_over_seeds(subject, partial(prepared.radiance, material, light, pixels))
            seen = shown.double().cpu().numpy().mean(axis=1)
            right = _in_world(turn @ in_map if turned else in_map, None if of_world else in_camera)
            found = _correlation(seen, normals, right)
            if found > 0.95:
                continue
            advice = "check the convention of lat-long images in docs/conventions.md"
            for mistake, directions in _mistaken_directions(in_map, turn if turned else None, in_camera, of_world):
                if _correlation(seen, normals, directions) > 0.95:
                    advice = f"the light acts as if {mistake}"
            frame = "world" if of_world else "camera"
            require(
                False,
                f"with the frame {frame!r} and {'a' if turned else 'no'} `to_world` the brightness of a diffuse sphere "
                f"correlates with max(0, n·ω) by {found:.2f}; {advice}",
            )


def _in_world(direction: np.ndarray, in_camera: np.ndarray | None) -> np.ndarray:
    """A direction as directions (N, 3) of the world; of a camera's axes where `in_camera` is the rotation (N, 3, 3) to
    them, else of the world's (1, 3).
    """
    return direction[None] if in_camera is None else np.swapaxes(in_camera, 1, 2) @ direction


def _mistaken_directions(
    in_map: np.ndarray, turn: np.ndarray | None, in_camera: np.ndarray, of_world: bool
) -> Iterator[tuple[str, np.ndarray]]:
    """What a renderer may take for the direction of the light, each with a sentence."""
    turned = in_map if turn is None else turn @ in_map
    frame = None if of_world else in_camera
    if turn is not None:
        yield "`to_world` were replaced by its inverse", _in_world(turn.T @ in_map, frame)
        yield "`to_world` were not there", _in_world(in_map, frame)
    if of_world:
        yield "the frame were 'camera'", _in_world(turned, in_camera)
    else:
        yield "the frame were 'world'", _in_world(turned, None)
        yield "the rotation of the camera were replaced by its inverse", in_camera @ turned
        yield "each camera were the first one", _in_world(turned, in_camera[:1])
    for axis, name in enumerate("xyz"):
        mirrored = in_map * np.where(np.arange(3) == axis, -1, 1)
        yield f"the map were mirrored along {name}", _in_world(mirrored if turn is None else turn @ mirrored, frame)


def _correlation(seen: np.ndarray, normals: np.ndarray, directions: np.ndarray) -> float:
    """Of brightness with max(0, n·ω); 0 where one of them does not vary."""
    expected = np.clip((normals * directions).sum(axis=1), 0, None)
    a, b = seen - seen.mean(), expected - expected.mean()
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float((a * b).sum()) / size if size > 0 else 0.0


@contract("reflectance_renderer", slow=True)
def linear_in_light(subject: Subject) -> None:
    """Three times the light is three times the radiance (equal seeds, to 1e-4); two lights together are their sum."""
    from hir_core.scene import EnvironmentMap
    from hir_core.testing.scenes import constant_material, looking_at, uneven_light

    light, camera = uneven_light(16), looking_at((0, 1, 4), SIZE)
    material = constant_material("dielectric", 0.4, 0.1, 0.4)
    prepared = _prepared(subject, _scene(material, light), camera)
    pixels = pixel_grid(step=2)

    def shown(radiance: Tensor, times: int = FEW) -> tuple[Tensor, Tensor]:
        return mean_over_seeds(subject, lambda: prepared.radiance(material, EnvironmentMap(radiance), pixels), times)

    once, thrice = shown(light.radiance)[0], shown(3 * light.radiance)[0]
    size = float(once.mean())
    require(size > 0, "a lit sphere is black")
    difference = float((thrice - 3 * once).abs().mean()) / (3 * size)
    require(
        difference < 1e-4, f"three times the light differs from three times the radiance by {100 * difference:.3g} %"
    )
    other = light.radiance.flip(1) * light.radiance.new_tensor([0.5, 1.0, 2.0])
    second, error = shown(other, MANY)
    both, error_both = shown(light.radiance + other, MANY)
    first, error_first = shown(light.radiance, MANY)
    noise = float((error**2 + error_both**2 + error_first**2).sqrt().mean())
    difference = abs(float((both - first - second).mean())) / float(both.mean())
    require(
        difference < 1e-4 + 4 * noise / float(both.mean()) / np.sqrt(len(pixels)),
        f"two lights together differ from their sum by {100 * difference:.3g} %",
    )


@contract("reflectance_renderer", traits={"material"}, slow=True)
def gradient_by_diffuse_albedo(subject: Subject) -> None:
    """The gradient by diffuse albedo agrees with central differences: within 3 %, and where the renderer is
    stochastic within four standard errors beyond that.
    """
    _compare_gradient(subject, "diffuse_albedo", 0.35, 0.45)


@contract("reflectance_renderer", traits={"material"}, unless={"lambertian"}, slow=True)
def gradient_by_specular_albedo(subject: Subject) -> None:
    """The gradient by specular albedo agrees with central differences: within 3 %, and where the renderer is
    stochastic within four standard errors beyond that.
    """
    _compare_gradient(subject, "specular_albedo", 0.15, 0.25)


@contract("reflectance_renderer", traits={"material"}, unless={"lambertian"}, slow=True)
def gradient_by_roughness(subject: Subject) -> None:
    """The gradient by roughness (GGX α) agrees with central differences: within 3 %, and where the renderer is
    stochastic within four standard errors beyond that.
    """
    _compare_gradient(subject, "roughness", 0.3, 0.5)


@contract("reflectance_renderer", traits={"environment"}, slow=True)
def gradient_by_light(subject: Subject) -> None:
    """The gradient by the light's radiance agrees with central differences: within 3 %, and where the renderer is
    stochastic within four standard errors beyond that.
    """
    _compare_gradient(subject, "radiance", 0.0, 0.0)


def _compare_gradient(subject: Subject, name: str, low: float, high: float) -> None:
    """Along one direction of a parameter: the mean of the gradient by Simpson's rule, exact to the fourth order,
    against the difference of the ends.
    """
    import torch

    from hir_core.testing.scenes import constant_material, looking_at, uneven_light

    light, camera = uneven_light(16), looking_at((0, 1, 4), SIZE)
    material = constant_material("dielectric", 0.4, 0.2, 0.4)
    prepared = _prepared(subject, _scene(material, light), camera)
    pixels = pixel_grid(step=2)
    weights = torch.rand(len(pixels), 3, generator=torch.Generator().manual_seed(1))
    if name == "radiance":
        step = 0.1 * torch.rand(light.radiance.shape, generator=torch.Generator().manual_seed(2))
        middle = light.radiance
        ends = [middle - step, middle + step]
    else:
        middle = getattr(material, name)
        ends = [torch.full_like(middle, v) for v in (low, high)]

    def value(at: Tensor) -> Tensor:
        if name == "radiance":
            shown = prepared.radiance(material, replace(light, radiance=at), pixels)
        else:
            shown = prepared.radiance(replace(material, **{name: at}), light, pixels)  # type: ignore[arg-type]
        return (shown * weights).sum()

    def slope() -> Tensor:
        total = torch.zeros(())
        for at, part in ((ends[0], 1 / 6), (middle, 4 / 6), (ends[1], 1 / 6)):
            leaf = at.clone().requires_grad_()
            (found,) = torch.autograd.grad(value(leaf), leaf)
            total = total + part * (found * (ends[1] - ends[0])).sum()
        return total

    try:
        gradient, gradient_error = mean_over_seeds(subject, slope, MANY)
    except RuntimeError as error:
        require(False, f"radiance carries no gradient by {name}, though the traits promise it: {error}")
        return
    difference, difference_error = mean_over_seeds(subject, lambda: value(ends[1]) - value(ends[0]), 6 * MANY)
    slack = 4 * float(np.hypot(float(gradient_error), float(difference_error)))
    require(
        abs(float(gradient - difference)) <= 0.03 * abs(float(difference)) + slack,
        f"by {name} the gradient says {float(gradient):.5g}, central differences {float(difference):.5g}"
        + (f" ± {slack / 4:.2g}" if slack else ""),
    )


@contract("reflectance_renderer", unless={"reference"}, slow=True)
def agrees_with_the_reference(subject: Subject) -> None:
    """Direct light with shadows agrees with the path-traced reference: bias below 1 %, and no block of 4×4 whole
    pixels is off by more than 10 % at a significance of 1 % over all blocks (t-tests with Šidák's correction).
    """
    import torch
    from scipy.stats import t as student

    from hir_core.testing.scenes import constant_material, looking_at, two_spheres, uneven_light

    reference = _reference(subject)
    light, camera = uneven_light(32), looking_at((0, 1, 4), SIZE)
    material = constant_material("dielectric", 0.4, 0.2, 0.3)
    if subject.has("lambertian"):
        material = constant_material("paper", 0.4, 0.0, 0.3)
    scene = _scene(material, light, two_spheres())
    pixels = pixel_grid()
    prepared = _prepared(subject, scene, camera)
    shown, shown_error = mean_over_seeds(subject, lambda: prepared.radiance(material, light, pixels), MANY)
    truth_of = reference.prepare(scene, capture_of([camera]))
    runs = []
    for seed in range(MANY):
        seeded(seed)
        runs.append(truth_of.radiance(material, light, pixels).detach().double())
    stacked = torch.stack(runs)
    truth, error = stacked.mean(0), stacked.std(0) / np.sqrt(MANY)
    # a pixel on an outline shows as much of the object as a renderer's pixel filter has it: only whole ones compare
    lit = (truth.sum(1) > 0).reshape(SIZE, SIZE).float()
    both = (torch.nn.functional.avg_pool2d(lit[None], 3, 1, 1)[0] > 0.999).reshape(-1)
    require(int(both.sum()) > 100, f"the reference shows the object in {int(both.sum())} whole pixels")
    missed = int((shown.sum(1)[both] == 0).sum())
    require(missed == 0, f"{missed} of {int(both.sum())} pixels that show the object are black")
    bias = float((shown - truth)[both].mean() / truth[both].mean())
    require(abs(bias) < 0.01, f"on average it is {100 * bias:+.2f} % from the reference")
    # blocks of 4×4 pixels: one pixel on the edge of a shadow says where the edge is, not how dark the shadow
    keep = both.reshape(SIZE, SIZE, 1).double()
    part = _blocks(keep).squeeze(-1)
    whole = part > 0.5
    means = [
        (_blocks(v.reshape(SIZE, SIZE, 3).double() * keep) / part[..., None].clamp_min(1e-9))[whole]
        for v in (shown, truth)
    ]
    variance = (error**2 + shown_error.double() ** 2).reshape(SIZE, SIZE, 3) * keep
    noise = (_blocks(variance) / (16 * part[..., None].clamp_min(1e-9) ** 2))[whole].sqrt().clamp_min(1e-12)
    beyond = ((means[0] - means[1]).abs() - 0.1 * means[1]) / noise
    # Šidák: of n independent tests at 1 - (1 - p)^(1/n) none rejects by chance with probability 1 - p
    limit = float(student.ppf(0.99 ** (1 / beyond.numel()), MANY - 1))
    worst = int(beyond.reshape(-1).argmax())
    far = 100 * float((means[0] / means[1] - 1).reshape(-1)[worst])
    require(
        float(beyond.max()) < limit,
        f"a block of pixels is {far:+.1f} % from the reference, {float(beyond.max()):.1f} "
        f"standard errors beyond 10 % (limit {limit:.1f})",
    )


@contract("reflectance_renderer", traits={"camera_lamp"}, slow=True)
def lamp_is_near_the_camera(subject: Subject) -> None:
    """A matt sphere under a lamp at the camera's centre, of radiant intensity I, shows albedo / π · I / r² in the
    middle of the picture (2 %), from two distances r. Towards the rim the exponent of the emission lobe darkens it by
    the power of the cosine to the viewing axis (2 %). A lamp to the right of the camera leaves the right side brighter.
    """
    import torch

    from hir_core.scene import CameraLamp, EnvironmentMap
    from hir_core.testing.scenes import constant_material, looking_at, smooth_sphere

    material, intensity = constant_material("paper", 0.5, 0.0, 0.5), 30.0
    dark = torch.full((8, 16, 3), 1e-6)
    middle, beside = SIZE // 2, SIZE // 2 + SIZE // 6
    pixels = torch.tensor([(0, middle, middle), (0, beside, middle), (0, SIZE - 1 - beside, middle)])

    def shown(distance: float, x: float, exponent: float) -> np.ndarray:
        lamp = CameraLamp(torch.full((3,), intensity), torch.tensor([x, 0.0, 0.0]), torch.tensor(exponent))
        light, camera = EnvironmentMap(dark, lamp=lamp), looking_at((0, 0, distance), SIZE)
        prepared = _prepared(subject, _scene(material, light, smooth_sphere(4)), camera)
        value, _ = mean_over_seeds(subject, lambda: prepared.radiance(material, light, pixels).mean(dim=1))
        return np.asarray(value.detach().cpu().double().numpy())

    for distance in (3.0, 5.0):
        expected = 0.5 / np.pi * intensity / (distance - 1) ** 2
        found = float(shown(distance, 0.0, 0.0)[0])
        require(
            abs(found / expected - 1) < 0.02,
            f"at a distance of {distance - 1:g} a surface that faces the lamp shows {found:.4f}, not {expected:.4f}: "
            "irradiance is intensity / r²",
        )
    direction = looking_at((0, 0, 3.0), SIZE).rays(np.array([[beside + 0.5, middle + 0.5]]))[1]
    cosine = float(-direction[0, 2])
    ratio = float(shown(3.0, 0.0, 20.0)[1] / shown(3.0, 0.0, 0.0)[1])
    require(
        abs(ratio / cosine**20 - 1) < 0.02,
        f"an exponent of 20 darkens a point off the viewing axis to {ratio:.3f} instead of {cosine**20:.3f}",
    )
    _, right, left = shown(3.0, 1.5, 0.0)
    require(right > 1.2 * left, f"a lamp to the right lights the right side by {right:.4f} and the left by {left:.4f}")


def _blocks(image: Tensor, side: int = 4) -> Tensor:
    """Means over blocks of side×side pixels (H W C)."""
    height, width, channels = image.shape
    return image.reshape(height // side, side, width // side, side, channels).mean(dim=(1, 3))


def _reference(subject: Subject) -> ReflectanceRenderer:
    """The installed renderer with the trait `reference`, for direct light."""
    found = [r for r in subject.plugins.components("reflectance_renderer") if "reference" in r.component.traits]
    usable = [r for r in found if not r.missing]
    if not usable:
        raise NotApplicable("no reference renderer is installed")
    fields = getattr(usable[0].component.config, "__dataclass_fields__", {})
    options = {name: value for name, value in (("max_depth", 2), ("samples", 64)) if name in fields}
    renderer: ReflectanceRenderer = subject.plugins.create("reflectance_renderer", usable[0].component.name, options)
    return renderer
