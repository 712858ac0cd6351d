"""Path tracing with multiple importance sampling (Veach 1997), as a plain function of the material and the light.

Light that meets the eye after at most `max_depth - 1` reflections (Mitsuba's count of `max_depth`: 2 is direct light).
Directions and densities are drawn without derivative, so differentiating the value differentiates the estimator's
integrand: unbiased, also for values that are 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from hir_plugins.reflectance_renderers.drjit_types import DrJitArray
from hir_plugins.reflectance_renderers.mitsuba_ggx.brdf_drjit import Reflectance, evaluate, pdf, sample
from hir_plugins.reflectance_renderers.mitsuba_ggx.emitter import Light
from hir_plugins.reflectance_renderers.mitsuba_ggx.mitsuba_mesh import FirstHit, Surface, SurfaceHit
from hir_plugins.reflectance_renderers.mitsuba_ggx.mitsuba_textures import Parameter
from hir_plugins.reflectance_renderers.mitsuba_ggx.point_lamp import PointLamp
from hir_plugins.reflectance_renderers.mitsuba_ggx.sample_sequence import SampleSequence


@dataclass
class Shading:
    """The material on the device."""

    model: str
    diffuse: Parameter
    specular: Parameter
    alpha: Parameter
    normal: Parameter | None

    def at(self, surface: Surface, point: SurfaceHit) -> tuple[Reflectance, DrJitArray]:
        """Parameters and shading frame at points of the surface."""
        u, v, active = point.u, point.v, point.valid
        reflectance = Reflectance(
            self.model, self.diffuse.at(u, v, active), self.specular.at(u, v, active), self.alpha.at(u, v, active)
        )
        normal = point.normal
        if self.normal is not None:
            color = self.normal.at(u, v, active)
            normal = surface.mapped_normal(point, mi.Vector3f(color.x, color.y, color.z))
        return reflectance, mi.Frame3f(normal)


def incoming(
    surface: Surface,
    shading: Shading,
    light: Light,
    light_from_world: DrJitArray,
    first: SurfaceHit,
    direction: DrJitArray,
    points: SampleSequence,
    max_depth: int,
    lamp: PointLamp | None = None,
    drops_ended: bool = False,
) -> DrJitArray:
    """Color3f: radiance from `first` towards the eye, along `direction`; 0 where `first` is not valid.

    `light_from_world` is a Matrix3f for each lane. A `lamp` adds its light; a point of light adds no noise. With
    `drops_ended` paths that have left the surface take no part in what follows: the same value, without derivative, in
    less time.
    """
    up: DrJitArray = mi.Vector3f(0, 0, 1)
    total: DrJitArray = dr.zeros(mi.Color3f, dr.width(direction))
    lanes: DrJitArray | None = None
    throughput: DrJitArray = mi.Color3f(1)
    point, active = first, mi.Bool(first.valid)
    for bounce in range(1, max_depth):
        reflectance, frame = shading.at(surface, point)
        # inactive lanes compute with a valid direction: a NaN would reach derivatives through masks
        eye = dr.select(active, frame.to_local(-direction), up)

        towards, density = light.sample(points.next())
        world = dr.detach(light_from_world.T @ towards)
        chosen = dr.select(active, frame.to_local(world), up)
        lit = active & (dr.detach(chosen.z) > 0)
        lit &= ~surface.occluded(surface.start(point, world), world, lit)
        weight = _power(density, dr.detach(pdf(reflectance, eye, chosen))) / dr.maximum(density, 1e-30)
        value = throughput * evaluate(reflectance, eye, chosen) * light.radiance(towards) * weight
        arriving: DrJitArray = dr.select(lit, value, mi.Color3f(0))

        if lamp is not None:
            arriving += _light_of_lamp(surface, reflectance, frame, lamp, point, eye, throughput, active, points.next())

        drawn = dr.detach(sample(reflectance, dr.detach(eye), points.next()))
        density = dr.detach(pdf(reflectance, dr.detach(eye), drawn))
        world = dr.detach(frame.to_world(drawn))
        active &= density > 0
        local = dr.select(active, frame.to_local(world), up)  # equal to `drawn`, but follows the normal map
        throughput *= dr.select(active, evaluate(reflectance, eye, local) / dr.maximum(density, 1e-30), 0)
        start = surface.start(point, world)
        last = bounce == max_depth - 1
        if last:
            escaped = active & ~surface.occluded(start, world, active)
        else:
            hit = surface.first_hit(start, world, active)
            escaped = active & ~hit.is_hit
        towards = dr.detach(light_from_world @ world)
        weight = _power(density, light.pdf(towards))
        arriving += dr.select(escaped, throughput * light.radiance(towards) * weight, 0)
        if lanes is None:
            total += arriving
        else:
            # each lane once; the default mode would compile another kernel for each size of `total`
            dr.scatter_reduce(dr.ReduceOp.Add, total, arriving, lanes, mode=dr.ReduceMode.NoConflicts)
        if last:
            break
        direction = world
        if drops_ended and bounce < max_depth - 2:  # before a single reflection it costs more than it saves
            dr.eval(total, hit, throughput, direction)
            going: DrJitArray = mi.UInt32(dr.compress(hit.is_hit))
            if dr.width(going) == 0:
                break
            lanes = going if lanes is None else dr.gather(mi.UInt32, lanes, going)
            hit, points = dr.gather(FirstHit, hit, going), points.gathered(going)
            throughput, direction = dr.gather(mi.Color3f, throughput, going), dr.gather(mi.Vector3f, direction, going)
            light_from_world = dr.gather(mi.Matrix3f, light_from_world, going)
            lamp = None if lamp is None else lamp.gathered(going)
        point = surface.at(hit, direction)
        active = mi.Bool(point.valid)
    return total


def _light_of_lamp(
    surface: Surface,
    reflectance: Reflectance,
    frame: DrJitArray,
    lamp: PointLamp,
    point: SurfaceHit,
    eye: DrJitArray,
    throughput: DrJitArray,
    active: DrJitArray,
    sample: DrJitArray,
) -> DrJitArray:
    """Color3f: what the points reflect of the lamp's light. Paths that hit its disc by chance do not count it again."""
    world, distance, irradiance = lamp.toward(dr.detach(point.position), sample)
    local = dr.select(active, frame.to_local(world), mi.Vector3f(0, 0, 1))
    lit = active & (dr.detach(local.z) > 0)
    lit &= ~surface.occluded(surface.start(point, world), world, lit, distance)
    return dr.select(lit, throughput * evaluate(reflectance, eye, local) * irradiance, 0)


def _power(a: DrJitArray, b: DrJitArray) -> DrJitArray:
    """The power heuristic for a sampler of density a against one of density b, without overflow."""
    ratio = b / dr.maximum(a, 1e-30)
    return dr.rcp(1 + dr.square(dr.minimum(ratio, 1e15)))
