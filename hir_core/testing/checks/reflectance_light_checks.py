"""Contracts of reflectance renderers: the light has its frame, radiance is linear in it, a lamp is near the camera."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from hir_core.testing.checks.reflectance_samples import (
    FEW,
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
from hir_core.testing.contract import Subject, contract, require

if TYPE_CHECKING:
    from torch import Tensor


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
    normals = ball_normals(pixels, cameras)
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
                spot_light(in_map / np.linalg.norm(in_map), 32, 20.0),
                torch.from_numpy(turn).float() if turned else None,
                "world" if of_world else "camera",
            )
            scene = sphere_scene(material, light, smooth_sphere(3))
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
    prepared = prepared_for(subject, sphere_scene(material, light), camera)
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
        prepared = prepared_for(subject, sphere_scene(material, light, smooth_sphere(4)), camera)
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


@contract("reflectance_renderer", traits={"camera_lamp"}, slow=True)
def lamp_is_as_large_as_its_radius(subject: Subject) -> None:
    """A disc of radius R around the camera's centre, across the viewing axis, is darker than a point: by 2 h² (1 − h /
    √(h² + R²)) / R² in the middle of a matt sphere at the distance h (2 %).
    """
    import torch

    from hir_core.scene import CameraLamp, EnvironmentMap
    from hir_core.testing.scenes import constant_material, looking_at, smooth_sphere

    material, intensity, distance = constant_material("paper", 0.5, 0.0, 0.5), 30.0, 2.0
    dark = torch.full((8, 16, 3), 1e-6)
    middle = [(0, SIZE // 2 + x, SIZE // 2 + y) for x in (-1, 0) for y in (-1, 0)]

    def shown(radius: float) -> float:
        lamp = CameraLamp(torch.full((3,), intensity), torch.zeros(3), torch.tensor(0.0), torch.tensor(radius))
        light, camera = EnvironmentMap(dark, lamp=lamp), looking_at((0, 0, distance + 1), SIZE)
        prepared = prepared_for(subject, sphere_scene(material, light, smooth_sphere(4)), camera)
        value, _ = mean_over_seeds(subject, lambda: prepared.radiance(material, light, torch.tensor(middle)).mean())
        return float(value.detach())

    point = shown(0.0)
    for radius in (0.5, 2.0):
        expected = point * distance**2 * 2 * (1 - distance / np.hypot(distance, radius)) / radius**2
        found = shown(radius)
        # without any light of the lamp both are dark, which breaks `lamp_is_near_the_camera`
        require(
            abs(found - expected) < 0.02 * expected + 1e-4,
            f"a lamp with a radius of {radius:g} at a distance of {distance:g} shows {found:.4f}, not {expected:.4f}: "
            "its irradiance is the mean over a disc across the viewing axis",
        )
