"""Light of a lamp that each camera carries: few directions for each pixel, the BRDF evaluated exactly for them.

A point of light needs no integral: its part of a pixel is `f · (n·wi) · intensity · cos(θ)^exponent / r²` where a ray
from the surface reaches the lamp. A disc is the mean of `DISC_POINTS` points on it, turned for each pixel, so that
neighbouring pixels average what few points leave. All is linear in the intensity and in ρs, and differentiable in
everything else but the shadow, which is traced anew where the lamp has moved.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from hir_core.capture import Camera, Capture
from hir_core.scene import CameraLamp
from hir_plugins.reflectance_renderers.brdf_torch import schlick_weight, specular_lobe
from hir_plugins.reflectance_renderers.ray_tracer import RayTracer
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.specular_lobes import MIN_EYE_COSINE
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import SurfacePoints

MIN_EMISSION_COSINE = 1e-3
"""Least cosine between the viewing axis and a ray of the lamp; its logarithm must be finite."""
DISC_POINTS = 8
"""Of a lamp with a radius, for each pixel."""
GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))
MIN_SHADOW_OFFSET = 1e-4
"""Of the lamp from the camera's centre, as a fraction of the distance: a nearer one shadows nothing that is seen."""


@dataclass(frozen=True, eq=False)
class LampCameras:
    """The cameras that carry the lamp; lengths are in `unit`, by view."""

    centers: Float[Tensor, "N 3"]
    axes: Float[Tensor, "N 3 3"]
    """Rows: the camera's x, y and z in the world."""
    unit: float
    """The unit of length of lamps, in the scene's. The fit uses the mean distance between cameras and object."""

    @classmethod
    def of(cls, cameras: Mapping[int, Camera], device: torch.device, unit: float = 1.0) -> LampCameras:
        """The cameras by number of the view; views without one have zeros."""
        count = max(cameras, default=-1) + 1
        centers, axes = np.zeros((count, 3), np.float32), np.zeros((count, 3, 3), np.float32)
        for view, camera in cameras.items():
            centers[view], axes[view] = camera.center, camera.world_to_camera[:3, :3]
        return cls(torch.from_numpy(centers).to(device), torch.from_numpy(axes).to(device), unit)

    @classmethod
    def of_capture(cls, capture: Capture, positions: Float[Tensor, "V 3"]) -> LampCameras:
        """The cameras of all views; the unit is their mean distance from the middle of the object."""
        middle = ((positions.max(dim=0).values + positions.min(dim=0).values) / 2).cpu().numpy()
        distances = [float(np.linalg.norm(camera.center - middle)) for camera in capture.cameras]
        return cls.of(dict(enumerate(capture.cameras)), positions.device, max(float(np.mean(distances)), 1e-30))

    def in_scene(self, lamp: CameraLamp) -> CameraLamp:
        """A lamp of this unit in the scene's."""
        return CameraLamp(
            lamp.intensity * self.unit**2, lamp.offset * self.unit, lamp.exponent, lamp.radius * self.unit
        )


@dataclass(frozen=True, eq=False)
class LampPoints:
    """Surface points, each before the camera of its view, whose lamp lights it.

    Vectors that shading needs are in the axes of the camera: there a lamp is at one place for all points. Shadows are
    those of the last `update_shadows`; before it there are none.
    """

    toward_camera: Float[Tensor, "P 3"]
    """From the point to the camera's centre, in the camera's axes and in units of `LampCameras`."""
    normal: Float[Tensor, "P 3"]
    """Shading normal, unit, in the camera's axes."""
    to_eye: Float[Tensor, "P 3"]
    """Unit, in the camera's axes."""
    axes: Float[Tensor, "P 3 3"]
    """Of the camera in the world, as `LampCameras.axes`."""
    origin: Float[Tensor, "P 3"]
    """Beside the point, outside the surface, in the world: where shadow rays begin."""
    tracer: RayTracer
    """Of the surface."""
    disc: Float[Tensor, "P K 2"]
    """Points of the unit disc, turned by an angle of each pixel's own."""
    lit: Bool[Tensor, "P K"]
    """Whether no part of the surface is between the point and each point of the lamp."""

    @classmethod
    def of(cls, points: SurfacePoints, cameras: LampCameras, tracer: RayTracer, ray_offset: float) -> LampPoints:
        """`tracer` of the surface; `ray_offset`: distance of ray origins from it, as `Transport.offset`."""
        axes = cameras.axes[points.view]
        toward = (cameras.centers[points.view] - points.position) / cameras.unit
        origin = points.position + ray_offset * (points.face_normal + points.normal)
        disc = turned_disc(len(points), toward)
        lit = torch.ones(disc.shape[:2], dtype=torch.bool, device=toward.device)
        seen = _rotated(axes, toward), _rotated(axes, points.normal), _rotated(axes, points.to_eye)
        return cls(*seen, axes, origin, tracer, disc, lit)

    def update_shadows(self, lamp: CameraLamp) -> None:
        """Traces the shadows of a lamp, one ray from each point to each of the lamp's, into `lit`."""
        with torch.no_grad():
            distance = float(self.toward_camera.norm(dim=1).mean())
            farthest = float(lamp.offset.detach().norm() + lamp.radius.detach())
            if not len(self.lit) or farthest < MIN_SHADOW_OFFSET * distance:
                self.lit.fill_(True)
                return
            x, y, z = self.rays(lamp).direction
            count = x.shape[1]
            in_camera = torch.stack([x, y, z], dim=2).reshape(-1, 3)
            direction = _rotated(self.axes.mT.repeat_interleave(count, dim=0), in_camera)
            origin = self.origin[:, None].expand(-1, count, -1).reshape(-1, 3)
            occluded = self.tracer.occluded(origin.cpu().numpy(), direction.cpu().numpy())
            self.lit.copy_(torch.from_numpy(~occluded).reshape(-1, count))

    def with_normals(self, normal: Float[Tensor, "P 3"]) -> LampPoints:
        """The same points with other shading normals, which are in the world."""
        return replace(self, normal=_rotated(self.axes, normal))

    def rays(self, lamp: CameraLamp) -> LampRays:
        """From each point to each point of the lamp."""
        across = lamp.offset[:2] + lamp.radius * self.disc
        toward_x, toward_y, toward_z = self.toward_camera[..., None].unbind(1)
        x, y, z = toward_x + across[..., 0], toward_y + across[..., 1], toward_z + lamp.offset[2]
        square = torch.addcmul(torch.addcmul(z.square(), x, x), y, y).clamp_min(1e-12)
        inverse = square.rsqrt()
        direction = x * inverse, y * inverse, z * inverse
        emission = (lamp.exponent * (-direction[2]).clamp_min(MIN_EMISSION_COSINE).log()).exp()
        normal = _planes(self.normal)
        strength = emission / square * self.lit
        return LampRays(direction, strength, _dot(direction, normal), normal, _planes(self.to_eye), lamp.intensity)


Planes: TypeAlias = tuple[Tensor, Tensor, Tensor]
"""x, y and z of vectors, each an array of its own: arithmetic on these takes a third of the time of (…, 3) arrays."""


@dataclass(frozen=True, eq=False)
class LampRays:
    """From P points to K points of a lamp, in the axes of the camera."""

    direction: Planes
    """Unit, each component (P, K)."""
    strength: Float[Tensor, "P K"]
    """Irradiance of a lamp of intensity 1 on a surface that faces it; 0 in a shadow."""
    cosine: Float[Tensor, "P K"]
    """Of the angle between ray and shading normal."""
    normal: Planes
    """Of the points, each component (P, 1)."""
    to_eye: Planes
    """Each component (P, 1)."""
    intensity: Float[Tensor, " 3"]
    """Of the lamp."""


def turned_disc(count: int, like: Tensor) -> Float[Tensor, "P K 2"]:
    """Points that fill the unit disc evenly, for each of `count` pixels at another multiple of the golden angle."""
    number = torch.arange(DISC_POINTS, device=like.device, dtype=like.dtype)
    radius = ((number + 0.5) / DISC_POINTS).sqrt()
    # in float64: an angle of many turns would lose its digits
    turn = (torch.arange(count, device=like.device, dtype=torch.float64) * GOLDEN_ANGLE) % (2 * math.pi)
    angle = number * GOLDEN_ANGLE + turn[:, None].to(like.dtype)
    return torch.stack([radius * angle.cos(), radius * angle.sin()], dim=2)


def lamp_irradiance(rays: LampRays) -> Float[Tensor, "P 3"]:
    """Irradiance of a lamp at points; differentiable in the lamp and in the normals."""
    return rays.intensity * (rays.strength * rays.cosine.clamp(0, 1)).mean(dim=1, keepdim=True)


def lamp_lobe(rays: LampRays, alpha: Float[Tensor, "#P 1"]) -> tuple[Float[Tensor, "P 3"], Float[Tensor, "P 3"]]:
    """Radiance of lobes with ρs = 1 from a lamp, and the same times Schlick's term; differentiable.

    With ρs the specular radiance is `ρs·(first − second) + second`, and `ρs·first` in the paper's model.
    """
    n_wi, n_wo, wo_wi = rays.cosine, _dot(rays.normal, rays.to_eye), _dot(rays.direction, rays.to_eye)
    # the half vector before it is normalized, and the square of its length
    half = _sum(rays.direction, rays.to_eye)
    square = (2 + 2 * wo_wi).clamp_min(1e-12)
    inverse = square.rsqrt()
    sin2 = _square(_cross(rays.normal, half)) / square
    lobe = specular_lobe(alpha, n_wi, n_wo.clamp_min(MIN_EYE_COSINE), (n_wi + n_wo) * inverse, sin2)
    white = rays.strength * lobe
    grazing = white * schlick_weight((1 + wo_wi) * inverse)
    return rays.intensity * white.mean(dim=1, keepdim=True), rays.intensity * grazing.mean(dim=1, keepdim=True)


def _rotated(axes: Float[Tensor, "P 3 3"], vectors: Float[Tensor, "P 3"]) -> Float[Tensor, "P 3"]:
    return (axes @ vectors[..., None])[..., 0]


def _planes(vectors: Float[Tensor, "P 3"]) -> Planes:
    """Each (P, 1)."""
    x, y, z = vectors[..., None].unbind(1)
    return x, y, z


def _sum(a: Planes, b: Planes) -> Planes:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _dot(a: Planes, b: Planes) -> Tensor:
    return torch.addcmul(torch.addcmul(a[0] * b[0], a[1], b[1]), a[2], b[2])


def _cross(a: Planes, b: Planes) -> Planes:
    return (
        torch.addcmul(a[1] * b[2], a[2], b[1], value=-1),
        torch.addcmul(a[2] * b[0], a[0], b[2], value=-1),
        torch.addcmul(a[0] * b[1], a[1], b[0], value=-1),
    )


def _square(a: Planes) -> Tensor:
    return torch.addcmul(torch.addcmul(a[0].square(), a[1], a[1]), a[2], a[2])
