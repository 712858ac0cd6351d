"""Light of a small lamp that each camera carries: one direction for each pixel, the BRDF evaluated exactly for it.

A point of light needs no integral: its part of a pixel is `f · (n·wi) · intensity · cos(θ)^exponent / r²` where a ray
from the surface reaches the lamp. It is linear in the intensity and in ρs, and differentiable in everything else but
the shadow, which is traced anew where the lamp has moved.
"""

from __future__ import annotations

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
        return CameraLamp(lamp.intensity * self.unit**2, lamp.offset * self.unit, lamp.exponent)


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
    lit: Bool[Tensor, " P"]
    """Whether no part of the surface is between the point and the lamp."""

    @classmethod
    def of(cls, points: SurfacePoints, cameras: LampCameras, tracer: RayTracer, ray_offset: float) -> LampPoints:
        """`tracer` of the surface; `ray_offset`: distance of ray origins from it, as `Transport.offset`."""
        toward = (cameras.centers[points.view] - points.position) / cameras.unit
        origin = points.position + ray_offset * (points.face_normal + points.normal)
        lit = torch.ones(len(points), dtype=torch.bool, device=toward.device)
        return cls(toward, cameras.axes[points.view], points.normal, points.to_eye, origin, tracer, lit)

    def update_shadows(self, offset: Float[Tensor, " 3"]) -> None:
        """Traces the shadows of a lamp at `offset`, one ray for each point, into `lit`."""
        with torch.no_grad():
            offset = offset.detach()
            if float(offset.norm()) < MIN_SHADOW_OFFSET * float(self.toward_camera.norm(dim=1).mean()):
                self.lit.fill_(True)
                return
            direction = normalize(self._toward(offset), dim=1, eps=1e-12)
            occluded = self.tracer.occluded(self.origin.cpu().numpy(), direction.cpu().numpy())
            self.lit.copy_(torch.from_numpy(~occluded))

    def with_normals(self, normal: Float[Tensor, "P 3"]) -> LampPoints:
        """The same points with other shading normals."""
        return replace(self, normal=normal)

    def arriving(self, lamp: CameraLamp) -> tuple[Float[Tensor, "P 3"], Float[Tensor, "P 3"]]:
        """Unit directions to the lamp, and its irradiance on a surface that faces it; 0 in a shadow."""
        toward = self._toward(lamp.offset)
        square = toward.square().sum(dim=1, keepdim=True).clamp_min(1e-12)
        direction = toward / square.sqrt()
        cosine = -(direction * self.axes[:, 2]).sum(dim=1, keepdim=True)
        emission = (lamp.exponent * cosine.clamp_min(MIN_EMISSION_COSINE).log()).exp()
        return direction, lamp.intensity * (emission / square * self.lit[:, None])

    def _toward(self, offset: Float[Tensor, " 3"]) -> Float[Tensor, "P 3"]:
        return self.toward_camera + (offset[None, None] @ self.axes)[:, 0]


def lamp_irradiance(points: LampPoints, lamp: CameraLamp) -> Float[Tensor, "P 3"]:
    """Irradiance of the lamp at points; differentiable in the lamp and in the normals."""
    direction, arriving = points.arriving(lamp)
    return arriving * (points.normal * direction).sum(dim=1, keepdim=True).clamp(0, 1)


def lamp_lobe(
    points: LampPoints, lamp: CameraLamp, alpha: Float[Tensor, "#P 1"]
) -> tuple[Float[Tensor, "P 3"], Float[Tensor, "P 3"]]:
    """Radiance of lobes with ρs = 1 from the lamp, and the same times Schlick's term; differentiable.

    With ρs the specular radiance is `ρs·(first − second) + second`, and `ρs·first` in the paper's model.
    """
    direction, arriving = points.arriving(lamp)
    half = normalize(direction + points.to_eye, dim=1, eps=1e-12)

    def cosine(a: Tensor, b: Tensor) -> Float[Tensor, "P 1"]:
        return (a * b).sum(dim=1, keepdim=True)

    sin2 = torch.linalg.cross(points.normal, half).square().sum(dim=1, keepdim=True)
    n_wo = cosine(points.normal, points.to_eye).clamp_min(MIN_EYE_COSINE)
    lobe = specular_lobe(alpha, cosine(points.normal, direction), n_wo, cosine(points.normal, half), sin2)
    white = arriving * lobe
    return white, white * schlick_weight(cosine(half, points.to_eye))
