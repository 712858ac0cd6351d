"""Contracts of reflectance renderers: finite radiance, energy, reciprocity, agreement with the reference."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from hir_core.testing.checks.reflectance_samples import (
    MANY,
    SIZE,
    ball_normals,
    capture_of,
    mean_over_seeds,
    pixel_grid,
    prepared_for,
    sphere_scene,
    spot_light,
)
from hir_core.testing.contract import NotApplicable, Subject, contract, require
from hir_core.testing.exercise import Exercise, seeded

if TYPE_CHECKING:
    from torch import Tensor

    from hir_core.capture import Camera
    from hir_core.plugins.interfaces import PreparedReflectance, ReflectanceRenderer
    from hir_core.scene import EnvironmentMap, Material


def _mean_of(radiance: Callable[[], Tensor]) -> Tensor:
    return radiance().mean(0)


def exercise(subject: Subject, device: str) -> Exercise:
    """Radiance of a glossy sphere under an uneven light, and a picture of it."""
    from hir_core.testing.scenes import constant_material, looking_at, uneven_light

    scene = sphere_scene(constant_material("dielectric", 0.4, 0.04, 0.3), uneven_light(16)).to(device)
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
    scene = sphere_scene(material, light)
    pixels = pixel_grid()
    prepared = prepared_for(subject, scene, camera)
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

    return torch.from_numpy(np.isfinite(ball_normals(pixels, [camera])).all(axis=1))


@contract("reflectance_renderer", slow=True)
def white_furnace(subject: Subject) -> None:
    """Under a light of 1 from everywhere a white diffuse sphere has the radiance 1 (to 1 %), and so has a `dielectric`
    with ρd = 1 (to 2 %). No material of the `paper` model with ρd + ρs ≤ 1 is brighter than the light. Of a renderer
    with the trait `lambertian` the diffuse sphere alone is tested.
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
    prepared = prepared_for(subject, sphere_scene(cases[0][1], white), camera)
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
        light = EnvironmentMap(spot_light(source, 64))
        camera = looking_at(tuple(4 * eye), SIZE)
        prepared = prepared_for(subject, sphere_scene(lobe, light, plane(2.0, 8)), camera)
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
    scene = sphere_scene(material, light, two_spheres())
    pixels = pixel_grid()
    prepared = prepared_for(subject, scene, camera)
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
