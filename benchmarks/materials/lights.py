"""Lights of the materials benchmark: lat-long images made by formula, and lamps that the camera carries.

An image has its row 0 at +Z and its centre column at +X, as the captures' environment files do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
HEIGHT = 128


@dataclass(frozen=True)
class LightClass:
    """A family of lights; `draw` makes the image (H, 2H, 3) of one of them."""

    draw: Callable[[np.random.Generator], Array]
    frame: Literal["world", "camera"] = "world"
    """Does the light stand in the world, or is it carried by the camera?"""
    lamp: float = 0.0
    """Radiant intensity of a point light beside the camera, relative to the image's mean."""


def directions(height: int = HEIGHT) -> Array:
    """Unit directions (H, 2H, 3) of the pixel centres."""
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(2 * height) + 0.5) / (2 * height), indexing="ij")
    azimuth, polar = 2 * np.pi * (0.5 - u), np.pi * v
    return np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=-1)


def _blob(center: Array, width_deg: float, sharpness: float = 2.0) -> Array:
    """A soft disc (H, 2H) of height 1 around a unit direction."""
    angle = np.degrees(np.arccos(np.clip(directions() @ center, -1, 1)))
    return np.exp(-((angle / width_deg) ** (2 * sharpness)))


def _box(center: Array, half_deg: tuple[float, float]) -> Array:
    """A rectangle (H, 2H) on the sphere with soft edges: a softbox or a window."""
    side = np.cross([0.0, 0.0, 1.0], center)
    side /= np.linalg.norm(side)
    up = np.cross(center, side)
    d = directions()
    front = d @ center
    x = np.degrees(np.arctan2(d @ side, np.maximum(front, 1e-6)))
    y = np.degrees(np.arctan2(d @ up, np.maximum(front, 1e-6)))
    inside = 1 / (1 + np.exp((np.abs(x) - half_deg[0]) / 1.5)) / (1 + np.exp((np.abs(y) - half_deg[1]) / 1.5))
    return np.where(front > 0, inside, 0.0)


def _upward(rng: np.random.Generator, low_deg: float, high_deg: float) -> Array:
    """A random direction between two elevations."""
    elevation, azimuth = np.radians(rng.uniform(low_deg, high_deg)), rng.uniform(0, 2 * np.pi)
    return np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])


def _sky(rng: np.random.Generator) -> Array:
    """A gradient from a coloured ground over the horizon to the zenith, with clouds."""
    z = directions()[..., 2:]
    zenith, horizon = np.array([0.25, 0.4, 0.8]), np.array([0.8, 0.85, 0.9])
    ground = rng.uniform(0.08, 0.3, 3)
    above = horizon + (zenith - horizon) * np.clip(z, 0, 1) ** 0.6
    return np.where(z > 0, above * (0.7 + 0.6 * _clouds(rng)[..., None]), ground)


def _clouds(rng: np.random.Generator) -> Array:
    d = directions()
    total = sum(np.sin(d @ (rng.normal(size=3) * scale) + rng.uniform(0, 6)) for scale in (2, 3, 5, 8, 8, 12))
    return 0.5 + 0.5 * np.tanh(total)


def _room(rng: np.random.Generator) -> Array:
    """Dim walls, a brighter ceiling, a warm floor."""
    z = directions()[..., 2:]
    wall, ceiling, floor = rng.uniform(0.1, 0.3, 3), np.full(3, rng.uniform(0.3, 0.6)), np.array([0.2, 0.13, 0.08])
    return np.where(z > 0.6, ceiling, np.where(z < -0.5, floor, wall)) * (0.8 + 0.4 * _clouds(rng)[..., None])


def _sun(rng: np.random.Generator) -> Array:
    sun = _blob(_upward(rng, 25, 65), 1.6)[..., None] * np.array([1.0, 0.92, 0.8])
    return 0.5 * _sky(rng) + rng.uniform(400, 900) * sun


def _overcast(rng: np.random.Generator) -> Array:
    return (
        _sky(rng).mean(axis=-1, keepdims=True) * np.array([0.97, 1.0, 1.04])
        + 0.5 * _blob(_upward(rng, 50, 80), 40.0, 1.0)[..., None]
    )


def _softboxes(rng: np.random.Generator) -> Array:
    image = np.full((HEIGHT, 2 * HEIGHT, 3), 0.06)
    for _ in range(3):
        box = _box(_upward(rng, 5, 60), (rng.uniform(8, 20), rng.uniform(10, 30)))
        image = image + box[..., None] * rng.uniform(4, 14) * rng.uniform(0.9, 1.0, 3)
    return image


def _windows(rng: np.random.Generator) -> Array:
    image = _room(rng)
    azimuth = rng.uniform(0, 2 * np.pi)
    for turn in (0.0, 0.7, 1.4):
        center = np.array([np.cos(azimuth + turn), np.sin(azimuth + turn), 0.25])
        image = image + _box(center / np.linalg.norm(center), (12, 18))[..., None] * np.array([7.0, 7.6, 8.4])
    return image


def _two_colors(rng: np.random.Generator) -> Array:
    warm, cold = np.array([1.0, 0.45, 0.15]), np.array([0.2, 0.45, 1.0])
    first = _upward(rng, 20, 50)
    second = np.array([-first[0], -first[1], first[2]])
    lamps = 40 * _blob(first, 7.0)[..., None] * warm + 30 * _blob(second, 9.0)[..., None] * cold
    return 0.12 + lamps


def _lamps(rng: np.random.Generator) -> Array:
    """A room with many small lamps."""
    image = _room(rng)
    for _ in range(8):
        warmth = np.array([1.0, rng.uniform(0.7, 0.95), rng.uniform(0.4, 0.9)])
        image = image + _blob(_upward(rng, 30, 85), rng.uniform(2.0, 4.0))[..., None] * rng.uniform(30, 90) * warmth
    return image


def _dim(rng: np.random.Generator) -> Array:
    return np.full((HEIGHT, 2 * HEIGHT, 3), 0.05) + 0.02 * _clouds(rng)[..., None]


LIGHTS: dict[str, LightClass] = {
    "sun": LightClass(_sun),
    "overcast": LightClass(_overcast),
    "softboxes": LightClass(_softboxes),
    "windows": LightClass(_windows),
    "two_colors": LightClass(_two_colors),
    "lamps": LightClass(_lamps),
    "turntable": LightClass(_softboxes, frame="camera"),
    "camera_lamp": LightClass(_dim, frame="camera", lamp=12.0),
}
"""`turntable`: the object turns, camera and softboxes stand still; `camera_lamp`: a flash on the camera."""


def light_image(name: str, rng: np.random.Generator) -> NDArray[np.float32]:
    """Lat-long radiance (H, 2H, 3) with a mean of 1 over the sphere."""
    image = np.maximum(LIGHTS[name].draw(rng), 0.0)
    rows = np.sin(np.pi * (np.arange(HEIGHT) + 0.5) / HEIGHT)[:, None, None]
    mean = (image * rows).sum() / (rows.sum() * image.shape[1] * 3)
    return (image / mean).astype(np.float32)
