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

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import normalize

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

    Shadows are those of the last `update_shadows`; before it there are none.
    """

    toward_camera: Float[Tensor, "P 3"]
    """From the point to the camera's centre, in units of `LampCameras`."""
    axes: Float[Tensor, "P 3 3"]
    normal: Float[Tensor, "P 3"]
    """Shading normal, unit."""
    to_eye: Float[Tensor, "P 3"]
    origin: Float[Tensor, "P 3"]
    """Beside the point, outside the surface: where shadow rays begin."""
    tracer: RayTracer
    """Of the surface."""
    disc: Float[Tensor, "P K 2"]
    """Points of the unit disc, turned by an angle of each pixel's own."""
    lit: Bool[Tensor, "P K"]
    """Whether no part of the surface is between the point and each point of the lamp."""

    @classmethod
    def of(cls, points: SurfacePoints, cameras: LampCameras, tracer: RayTracer, ray_offset: float) -> LampPoints:
        """`tracer` of the surface; `ray_offset`: distance of ray origins from it, as `Transport.offset`."""
        toward = (cameras.centers[points.view] - points.position) / cameras.unit
        origin = points.position + ray_offset * (points.face_normal + points.normal)
        disc = turned_disc(len(points), toward)
        lit = torch.ones(disc.shape[:2], dtype=torch.bool, device=toward.device)
        return cls(toward, cameras.axes[points.view], points.normal, points.to_eye, origin, tracer, disc, lit)

    def update_shadows(self, lamp: CameraLamp) -> None:
        """Traces the shadows of a lamp, one ray from each point to each of the lamp's, into `lit`."""
        with torch.no_grad():
            distance = float(self.toward_camera.norm(dim=1).mean())
            farthest = float(lamp.offset.detach().norm() + lamp.radius.detach())
            if not len(self.lit) or farthest < MIN_SHADOW_OFFSET * distance:
                self.lit.fill_(True)
                return
            toward = self._toward(lamp)
            direction = normalize(toward, dim=2, eps=1e-12)
            count = toward.shape[1]
            origin = self.origin[:, None].expand(-1, count, -1).reshape(-1, 3)
            occluded = self.tracer.occluded(origin.cpu().numpy(), direction.reshape(-1, 3).cpu().numpy())
            self.lit.copy_(torch.from_numpy(~occluded).reshape(-1, count))

    def with_normals(self, normal: Float[Tensor, "P 3"]) -> LampPoints:
        """The same points with other shading normals."""
        return replace(self, normal=normal)

    def arriving(self, lamp: CameraLamp) -> tuple[Float[Tensor, "P K 3"], Float[Tensor, "P K 3"]]:
        """Unit directions to points of the lamp, and the irradiance of each on a surface that faces it; 0 in a shadow.

        The lamp's is the mean over its points.
        """
        toward = self._toward(lamp)
        square = toward.square().sum(dim=2, keepdim=True).clamp_min(1e-12)
        direction = toward / square.sqrt()
        cosine = -(direction * self.axes[:, None, 2]).sum(dim=2, keepdim=True)
        emission = (lamp.exponent * cosine.clamp_min(MIN_EMISSION_COSINE).log()).exp()
        return direction, lamp.intensity * (emission / square * self.lit[..., None])

    def _toward(self, lamp: CameraLamp) -> Float[Tensor, "P K 3"]:
        place = lamp.offset[:2] + lamp.radius * self.disc
        x, y, z = self.axes[:, None].unbind(2)
        shifted = place[..., :1] * x + place[..., 1:] * y + lamp.offset[2] * z
        return self.toward_camera[:, None] + shifted


def turned_disc(count: int, like: Tensor) -> Float[Tensor, "P K 2"]:
    """Points that fill the unit disc evenly, for each of `count` pixels at another multiple of the golden angle."""
    number = torch.arange(DISC_POINTS, device=like.device, dtype=like.dtype)
    radius = ((number + 0.5) / DISC_POINTS).sqrt()
    # in float64: an angle of many turns would lose its digits
    turn = (torch.arange(count, device=like.device, dtype=torch.float64) * GOLDEN_ANGLE) % (2 * math.pi)
    angle = number * GOLDEN_ANGLE + turn[:, None].to(like.dtype)
    return torch.stack([radius * angle.cos(), radius * angle.sin()], dim=2)


def lamp_irradiance(points: LampPoints, lamp: CameraLamp) -> Float[Tensor, "P 3"]:
    """Irradiance of the lamp at points; differentiable in the lamp and in the normals."""
    direction, arriving = points.arriving(lamp)
    cosine = (points.normal[:, None] * direction).sum(dim=2, keepdim=True).clamp(0, 1)
    return (arriving * cosine).mean(dim=1)


def lamp_lobe(
    points: LampPoints, lamp: CameraLamp, alpha: Float[Tensor, "#P 1"]
) -> tuple[Float[Tensor, "P 3"], Float[Tensor, "P 3"]]:
    """Radiance of lobes with ρs = 1 from the lamp, and the same times Schlick's term; differentiable.

    With ρs the specular radiance is `ρs·(first − second) + second`, and `ρs·first` in the paper's model.
    """
    direction, arriving = points.arriving(lamp)
    normal, eye = points.normal[:, None], points.to_eye[:, None]
    half = normalize(direction + eye, dim=2, eps=1e-12)

    def cosine(a: Tensor, b: Tensor) -> Float[Tensor, "P K 1"]:
        return (a * b).sum(dim=2, keepdim=True)

    sin2 = torch.linalg.cross(normal.expand_as(half), half).square().sum(dim=2, keepdim=True)
    n_wo = cosine(normal, eye).clamp_min(MIN_EYE_COSINE)
    lobe = specular_lobe(alpha[:, None], cosine(normal, direction), n_wo, cosine(normal, half), sin2)
    white = arriving * lobe
    return white.mean(dim=1), (white * schlick_weight(cosine(half, eye))).mean(dim=1)
