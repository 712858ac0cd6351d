"""A frozen mesh and cameras: radiance of pixels, with derivatives from independent samples."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from hir_core.capture import Camera
from hir_core.errors import StageError
from hir_core.plugins.interfaces import PreparedReflectance
from hir_core.scene import CameraLamp, EnvironmentMap, Material
from hir_plugins.reflectance_renderers.drjit_arrays import floats, to_color, to_float, to_torch, to_uint
from hir_plugins.reflectance_renderers.drjit_types import DrJitArray
from hir_plugins.reflectance_renderers.mitsuba_ggx.emitter import Light
from hir_plugins.reflectance_renderers.mitsuba_ggx.mitsuba_mesh import Surface
from hir_plugins.reflectance_renderers.mitsuba_ggx.mitsuba_textures import Parameter
from hir_plugins.reflectance_renderers.mitsuba_ggx.path_tracing import Shading, incoming
from hir_plugins.reflectance_renderers.mitsuba_ggx.point_lamp import PointLamp
from hir_plugins.reflectance_renderers.mitsuba_ggx.sample_sequence import SampleSequence, lanes

LANES = 1 << 20
"""Paths in one launch: bounds memory at about 200 MB."""


class Cameras:
    """The cameras of all views as arrays, for rays of mixed views."""

    def __init__(self, cameras: Sequence[Camera], surface: Surface) -> None:
        if any(any(camera.distortion) for camera in cameras):
            raise StageError("a camera has lens distortion; this renderer takes pinhole cameras, so undistort first")
        self.count = len(cameras)
        self.rotations = [np.asarray(c.world_to_camera[:3, :3], dtype=np.float64) for c in cameras]
        directions = [r.T @ np.linalg.inv(c.intrinsics) for r, c in zip(self.rotations, cameras, strict=True)]
        centers = [(np.asarray(c.center) - surface.center) / surface.radius for c in cameras]
        self._directions = floats(np.array(directions), mi)
        self._centers = floats(np.array(centers), mi)
        self._from_world = floats(np.array(self.rotations), mi)
        self._radius = surface.radius

    def rays(self, view: DrJitArray, x: DrJitArray, y: DrJitArray) -> tuple[DrJitArray, DrJitArray]:
        """Origins and unit directions, in the unit sphere, of rays through pixel positions."""
        direction = _matrix(self._directions, view) @ mi.Vector3f(x, y, 1)
        return dr.gather(mi.Point3f, self._centers, view), dr.normalize(direction)

    def lamp(self, lamp: CameraLamp, view: DrJitArray) -> PointLamp:
        """The lamp of each view's camera, in the unit sphere."""
        center = dr.gather(mi.Point3f, self._centers, view)
        return PointLamp.of(lamp, _matrix(self._from_world, view), center, self._radius)

    def light_from_world(self, environment: EnvironmentMap) -> tuple[DrJitArray, bool]:
        """Rotations (9 floats each) from the world to the axes of the light, and whether each view has its own."""
        to_frame = np.eye(3)
        if environment.to_world is not None:
            to_frame = environment.to_world.detach().cpu().numpy().astype(np.float64)
        each = environment.frame == "camera"
        rotations = [to_frame.T @ r for r in self.rotations] if each else [to_frame.T]
        return floats(np.array(rotations), mi), each


@dataclass
class Traced:
    """Radiance and coverage of pixels."""

    color: Tensor
    """(B, 3): mean over the samples that hit the object."""
    coverage: Tensor
    """(B,): the share of these samples."""


class PreparedMitsuba(PreparedReflectance):
    """Rays for pixels of any views, traced against one acceleration structure."""

    def __init__(
        self,
        surface: Surface,
        cameras: Sequence[Camera],
        samples: int,
        gradient_samples: int,
        max_depth: int,
        enter: Callable[[], ModuleType],
    ) -> None:
        self._surface = surface
        self._cameras = Cameras(cameras, surface)
        self._samples = samples
        self._gradient_samples = gradient_samples or samples
        self._max_depth = max_depth
        self._enter = enter

    def radiance(
        self, material: Material, environment: EnvironmentMap, pixels: Int[Tensor, "B 3"]
    ) -> Float[Tensor, "B 3"]:
        """Mean radiance of the object through each pixel (view, x, y), 0 where no sample meets it.

        Seeds come from torch's generator. The derivative uses samples that the value has not seen, so that the gradient
        of any loss is that of its expected derivative at independent samples.
        """
        return _Radiance.apply(  # type: ignore[no-any-return]
            self,
            material,
            environment,
            pixels,
            material.diffuse_albedo,
            material.specular_albedo,
            material.roughness,
            material.normal,
            environment.radiance,
        )

    def trace(
        self, material: Material, environment: EnvironmentMap, pixels: Int[Tensor, "B 3"], samples: int, seed: int
    ) -> Traced:
        """Radiance and coverage of pixels, not differentiable."""
        self._enter()
        shading, light = upload(material, self._surface), Light.of(environment.radiance)
        device = environment.radiance.device
        parts = [Traced(torch.zeros(0, 3, device=device), torch.zeros(0, device=device))]
        for _, part in _launches(pixels, samples):
            lane = self._lanes(environment, part, samples, seed)
            color = self._paths(shading, light, lane, drops_ended=True)
            # evaluated together: each block sum evaluates its argument, which would trace the paths four times
            dr.eval(color, lane.hit)
            total = mi.Color3f(*[dr.block_sum(color[i], samples) for i in range(3)])
            count = to_torch(dr.block_sum(lane.hit, samples), (-1,), device)
            parts.append(Traced(to_color(total, device) / count.clamp_min(1)[:, None], count / samples))
        return Traced(torch.cat([p.color for p in parts]), torch.cat([p.coverage for p in parts]))

    def coverage(self, pixels: Int[Tensor, "B 3"], samples: int, seed: int) -> Float[Tensor, " B"]:
        """Share of the samples of each pixel that hit the object; they are those of `trace` for the same seed."""
        self._enter()
        parts = [torch.zeros(0, device=self._surface.device)]
        for _, part in _launches(pixels, samples):
            lane = self._lanes(None, part, samples, seed)
            parts.append(to_torch(dr.block_sum(lane.hit, samples), (-1,), self._surface.device) / samples)
        return torch.cat(parts)

    def gradients(
        self,
        material: Material,
        environment: EnvironmentMap,
        pixels: Int[Tensor, "B 3"],
        upstream: Tensor,
        seed: int,
        needs: dict[str, bool],
    ) -> dict[str, Tensor]:
        """Derivative of `(radiance · upstream).sum()` with respect to the parameters in `needs`, from samples of
        `seed`."""
        self._enter()
        samples = self._gradient_samples
        shading, light = upload(material, self._surface), Light.of(environment.radiance)
        leaves: dict[str, Parameter | Light | None] = {
            "diffuse": shading.diffuse,
            "specular": shading.specular,
            "alpha": shading.alpha,
            "normal": shading.normal,
            "light": light,
        }
        wanted = {name: leaf for name, leaf in leaves.items() if needs[name] and leaf is not None}
        for leaf in wanted.values():
            dr.enable_grad(leaf.values)
        for start, part in _launches(pixels, samples):
            lane = self._lanes(environment, part, samples, seed)
            color = self._paths(shading, light, lane)
            weight = upstream[start : start + len(part)].detach()
            scaled = [to_float(weight[:, i], mi) for i in range(3)]
            share: DrJitArray = dr.rcp(dr.maximum(dr.gather(mi.Float, dr.block_sum(lane.hit, samples), lane.pixel), 1))
            adjoint: DrJitArray = mi.Color3f(*[dr.gather(mi.Float, s, lane.pixel) for s in scaled])
            adjoint *= share
            if dr.grad_enabled(color):
                dr.backward_from(dr.dot(color, adjoint))
        result = {}
        for name, leaf in wanted.items():
            like = environment.radiance if name == "light" else tensors_of(material)[name]
            assert like is not None
            result[name] = leaf.gradient(like)
        return result

    def _lanes(self, environment: EnvironmentMap | None, pixels: Tensor, samples: int, seed: int) -> _Lanes:
        pixel, sample = lanes(len(pixels), samples)
        columns = [to_uint(pixels[:, i], mi) for i in range(3)]
        view, x, y = (dr.gather(mi.UInt32, column, pixel) for column in columns)
        # opaque: a literal would compile a new kernel in every step
        points = SampleSequence((x + (y << 16), view), sample, samples, dr.opaque(mi.UInt32, seed))
        inside = points.next()
        origin, direction = self._cameras.rays(view, mi.Float(x) + inside.x, mi.Float(y) + inside.y)
        first = self._surface.intersect(origin, direction, mi.Bool(True), coherent=True)
        rotation = lamp = None
        if environment is not None:
            if environment.lamp is not None:
                lamp = self._cameras.lamp(environment.lamp, view)
            table, each = self._cameras.light_from_world(environment)
            rotation = _matrix(table, view if each else dr.zeros(mi.UInt32, dr.width(view)))
        return _Lanes(pixel, first, direction, points, dr.select(first.valid, mi.Float(1), 0), rotation, lamp)

    def _paths(self, shading: Shading, light: Light, lane: _Lanes, drops_ended: bool = False) -> DrJitArray:
        return incoming(
            self._surface,
            shading,
            light,
            lane.rotation,
            lane.first,
            lane.direction,
            lane.points,
            self._max_depth,
            lane.lamp,
            drops_ended,
        )


@dataclass
class _Lanes:
    """The samples of a launch up to their first hit."""

    pixel: DrJitArray
    first: DrJitArray
    direction: DrJitArray
    points: SampleSequence
    hit: DrJitArray
    """Float: 1 where the sample hit the object."""
    rotation: DrJitArray
    lamp: PointLamp | None


class _Radiance(torch.autograd.Function):
    """Dr.Jit's value and derivative as a torch function; the trailing tensors are those of material and environment."""

    @staticmethod
    def forward(  # type: ignore[override]
        ctx: Any,
        prepared: PreparedMitsuba,
        material: Material,
        environment: EnvironmentMap,
        pixels: Tensor,
        *tensors: Tensor | None,
    ) -> Tensor:
        seeds = torch.randint(0, 2**31 - 1, (2,)).tolist()
        ctx.call = (prepared, material, environment, pixels, seeds[1])
        return prepared.trace(material, environment, pixels, prepared._samples, seeds[0]).color

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> Any:
        prepared, material, environment, pixels, seed = ctx.call
        names = ("diffuse", "specular", "alpha", "normal", "light")
        needs = dict(zip(names, ctx.needs_input_grad[4:], strict=True))
        gradients = prepared.gradients(material, environment, pixels, upstream[0], seed, needs)
        return (None, None, None, None, *[gradients.get(name) for name in names])


def upload(material: Material, surface: Surface) -> Shading:
    """The material's parameters on the device; raises `StageError` for a texture without texture coordinates."""
    tensors = tensors_of(material)
    if not surface.has_uvs and any(t is not None and t.ndim == 3 for t in tensors.values()):
        raise StageError("the material has textures but the mesh no texture coordinates; let the atlas stage run")
    normal = tensors["normal"]
    return Shading(
        material.model,
        Parameter.of(material.diffuse_albedo),
        Parameter.of(material.specular_albedo),
        Parameter.of(material.roughness),
        None if normal is None else Parameter.of(normal),
    )


def tensors_of(material: Material) -> dict[str, Tensor | None]:
    """The differentiable tensors by short name."""
    return {
        "diffuse": material.diffuse_albedo,
        "specular": material.specular_albedo,
        "alpha": material.roughness,
        "normal": material.normal,
    }


def _launches(pixels: Tensor, samples: int) -> list[tuple[int, Tensor]]:
    """Chunks of pixels whose samples fit into one launch, with the index of their first."""
    step = max(LANES // samples, 1)
    return [(start, pixels[start : start + step]) for start in range(0, len(pixels), step)]


def _matrix(values: DrJitArray, index: DrJitArray) -> DrJitArray:
    rows = [dr.gather(mi.Vector3f, values, index * 3 + row) for row in range(3)]
    return mi.Matrix3f([[r.x, r.y, r.z] for r in rows])
