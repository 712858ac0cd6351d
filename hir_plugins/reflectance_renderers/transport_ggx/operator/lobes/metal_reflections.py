"""Metal that reflects metal: directions of a lobe that hit metal are reflected on until they leave the surface.

The cells of the irradiance cache reflect like a diffuse surface, which a metal is not. A direction that hits metal goes
on at visible normals of the metal's lobe. What it brings back is the light at its end times the colours on its way.
Their brightness is a part of its weight, their hue is that of the mean metal. So after n reflections it reads block n
of the sources, which are those of block 0 times the n-th power of that colour.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import torch
from jaxtyping import Float, Int
from torch import Tensor

from hir_plugins.reflectance_renderers.drjit_arrays import to_float, to_uint
from hir_plugins.reflectance_renderers.drjit_types import DrJitArray, MitsubaObject
from hir_plugins.reflectance_renderers.mitsuba_ggx.brdf_drjit import (
    above_horizon,
    clamped_alpha,
    fifth,
    smith_denominator,
    visible_lobe,
    visible_normal,
)
from hir_plugins.reflectance_renderers.ray_tracer import RayTracer
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.spiral import TURN

MAX_REFLECTIONS = 3
"""Of a direction, after its first hit. What hits the surface after them reads the irradiance cache."""
SPLIT = 4
"""Reflected directions of each direction that hits metal: as many as it has columns in the matrices."""
METAL_FROM = 0.5
"""Metalness from which a cell reflects like a metal."""
MIN_BRIGHTNESS = 1e-3
"""Of the mean metal: weights are divided by it."""
NUMBERS_OF_PATH = 16
"""Random numbers of a reflected direction, at least."""


@dataclass(frozen=True, eq=False)
class MetalSurface:
    """The metal that directions may hit: a surface, and reflectances of its C cache cells."""

    normals: Float[Tensor, "V 3"]
    faces: Int[Tensor, "F 3"]
    offset: float
    """Distance from the surface at which reflected rays start."""
    brightness: Float[Tensor, " C"]
    """Mean of the colours of the reflectance at normal incidence; negative where a cell is no metal."""
    alpha: Float[Tensor, " C"]
    mean_brightness: float
    """Mean of the colours by which block 1 of the sources is multiplied."""
    reflections: int

    @property
    def blocks(self) -> int:
        """Blocks of the sources."""
        return self.reflections + 1


@dataclass(frozen=True, eq=False)
class ReflectedEnds:
    """Where R reflected directions end."""

    entry: DrJitArray
    """Number of the direction that each continues, times `SPLIT`, plus its own number among those that do."""
    direction: DrJitArray
    density: DrJitArray
    """Of the last reflection, per solid angle."""
    blocked: DrJitArray
    """Does it end on the surface, in `cell`?"""
    cell: DrJitArray
    reflections: DrJitArray
    weight: DrJitArray
    drawn: DrJitArray
    """A random number in 0…1, for the texel that it reads."""


def metal_color(base_color: Float[Tensor, "V 3"], metalness: Float[Tensor, "#V 1"]) -> Float[Tensor, " 3"]:
    """Mean base colour of the metal."""
    weight = metalness.expand(len(base_color), 1)
    return (base_color * weight).sum(dim=0) / weight.sum().clamp_min(1e-6)


def sources_by_reflections(
    sources: Float[Tensor, "S 3"], color: Float[Tensor, " 3"], reflections: int
) -> Float[Tensor, "B*S 3"]:
    """The blocks of the sources after 0, 1, 2… reflections by metal of one colour."""
    blocks = [sources]
    for _ in range(reflections):
        blocks.append(blocks[-1] * color)
    return torch.cat(blocks)


def reflected_ends(
    tracer: RayTracer,
    metal: MetalSurface,
    cells: DrJitArray,
    ray: MitsubaObject,
    hit: MitsubaObject,
    blocked: DrJitArray,
    first_path: int,
    seed: int,
) -> ReflectedEnds | None:
    """Reflects the rays that hit metal; None where none does. `cells`: the cache cell of each face.

    `first_path` is added to the numbers of the rays, with which random numbers are drawn.
    """
    brightness = to_float(metal.brightness, mi)
    cell = dr.gather(mi.Int32, cells, hit.prim_index, blocked)
    on_metal = blocked & (dr.gather(mi.Float, brightness, cell, blocked) >= 0)
    start: list[DrJitArray] = [
        mi.Point3f(ray.o),
        mi.Vector3f(ray.d),
        mi.Float(hit.t),
        mi.UInt32(hit.prim_index),
        mi.Point2f(hit.prim_uv),
    ]
    dr.eval(start, on_metal)
    on_rays: DrJitArray = dr.compress(on_metal)
    if dr.width(on_rays) == 0:
        return None
    rays: DrJitArray = dr.repeat(on_rays, SPLIT)
    own: DrJitArray = dr.arange(mi.UInt32, dr.width(rays)) % SPLIT
    origin, direction, distance, face, uv = (dr.gather(type(each), each, rays) for each in start)
    entry = rays * SPLIT + own
    # a stream of random numbers for each path, and for each draw of the same path
    path: DrJitArray = mi.UInt32(first_path * SPLIT) + entry
    stream = (seed ^ (seed >> 32)) * NUMBERS_OF_PATH & 0xFFFFFFFF

    def drawn(number: int) -> DrJitArray:
        key: DrJitArray = mi.UInt32(stream + number & 0xFFFFFFFF)
        return mi.sample_tea_float32(path, key)

    normals, faces, widths = to_float(metal.normals, mi), to_uint(metal.faces, mi), to_float(metal.alpha, mi)
    found, reflections = mi.Bool(True), mi.UInt32(0)
    density, weight = mi.Float(1), mi.Float(1)
    cell = dr.gather(mi.Int32, cells, face)
    for number in range(metal.reflections):
        shine = dr.gather(mi.Float, brightness, cell, found)
        reflects = found & (shine >= 0)
        corners = [dr.gather(mi.UInt32, faces, face * 3 + corner, reflects) for corner in range(3)]
        at = [dr.gather(mi.Vector3f, normals, corner, reflects) for corner in corners]
        normal = dr.normalize((1 - uv.x - uv.y) * at[0] + uv.x * at[1] + uv.y * at[2])
        frame = mi.Frame3f(normal)
        eye = above_horizon(frame.to_local(-direction))
        area, turn = drawn(2 * number), drawn(2 * number + 1)
        if number == 0:  # the directions of one ray are spread over the lobe
            area, turn = (own + area) / SPLIT, turn + own * TURN
            turn -= dr.floor(turn)
        width = clamped_alpha(dr.gather(mi.Float, widths, cell, reflects))
        half = visible_normal(eye, width, mi.Point2f(area, turn))
        half_eye = dr.clip(dr.dot(half, eye), 0, 1)
        light = 2 * half_eye * half - eye
        above = light.z > 0
        cosine = dr.maximum(light.z, 0)
        masking = 2 * cosine / smith_denominator(cosine, width)
        gain = (shine + (1 - shine) * fifth(1 - half_eye)) / metal.mean_brightness * masking
        weight = dr.select(reflects, dr.select(above, weight * gain, 0), weight)
        density = dr.select(reflects, visible_lobe(half, eye, width), density)
        reflections = dr.select(reflects, mi.UInt32(number + 1), reflections)
        origin += direction * distance + metal.offset * normal
        direction = dr.select(reflects, frame.to_world(light), direction)
        goes_on = reflects & above
        hit = tracer.scene.ray_intersect_preliminary(mi.Ray3f(origin, direction), coherent=False, active=goes_on)
        hits = hit.is_valid() & goes_on
        face, uv, distance = hit.prim_index, hit.prim_uv, hit.t
        cell = dr.select(hits, dr.gather(mi.Int32, cells, face, hits), cell)
        found = dr.select(reflects, hits, found)
    return ReflectedEnds(entry, direction, density, found, cell, reflections, weight, drawn(NUMBERS_OF_PATH - 1))
