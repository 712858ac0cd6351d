"""Directions of lobes and of hemispheres: drawn, traced and looked up in the light by one kernel (Dr.Jit).

In torch each step would pass through memory, which takes three times as long (docs/studies/directions_of_lobes.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
import torch
from jaxtyping import Float, Int
from numpy.typing import NDArray
from torch import Tensor

from hir_plugins.reflectance_renderers.drjit_arrays import copy_to_torch, to_float, to_uint
from hir_plugins.reflectance_renderers.drjit_bilinear import AxisNeighbours, extended, repeated
from hir_plugins.reflectance_renderers.drjit_latlong import latlong_coordinates
from hir_plugins.reflectance_renderers.drjit_types import DrJitArray
from hir_plugins.reflectance_renderers.mitsuba_ggx.brdf_drjit import clamped_alpha, visible_lobe, visible_normal
from hir_plugins.reflectance_renderers.ray_tracer import RayTracer
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_pyramid import Pyramid
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.metal_reflections import (
    SPLIT,
    MetalSurface,
    ReflectedEnds,
    reflected_ends,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import SurfacePoints, tangent_frame

LEVEL_OFFSET = 0.0
"""Directions read the light so many levels coarser than their cone (docs/studies/directions_of_lobes.md)."""
MIN_DENSITY = 1e-12
"""Of a direction: its inverse stays finite in float32."""
MIN_HEMISPHERE_COSINE = 0.05
"""A direction near the horizon stands for at most the solid angle of one with this cosine."""
BILINEAR_OF_CELL = 0.25
"""Weight of each of the four equal columns of a direction that hits the surface."""
LANES = 1 << 19
"""Directions of one launch: bounds its memory at about 50 MB."""


@dataclass(frozen=True, eq=False)
class DirectionFrames:
    """Where the directions of P points start, and what they are relative to."""

    origin: Float[Tensor, "P 3"]
    axes: Float[Tensor, "P 3 3"]
    """Rows: tangent, bitangent and normal in the world."""
    view: Int[Tensor, " P"]

    @classmethod
    def of(cls, points: SurfacePoints, offset: float) -> DirectionFrames:
        """The frames of points of the surface; origins are moved away from it by `offset`."""
        axes = torch.stack([*tangent_frame(points.normal), points.normal], dim=1)
        return cls(points.position + offset * (points.face_normal + points.normal), axes, points.view)

    def part(self, rows: slice) -> DirectionFrames:
        """Those of a range of the points."""
        return DirectionFrames(self.origin[rows], self.axes[rows], self.view[rows])


class TracedLobes(NamedTuple):
    """K directions of each of P lobes; the fields of `Lobes` of the same names."""

    columns: Int[Tensor, "P 4K"]
    bilinear: Float[Tensor, "P 4K"]
    n_wi: Float[Tensor, "P K"]
    n_h: Float[Tensor, "P K"]
    sin2_h: Float[Tensor, "P K"]
    h_wo: Float[Tensor, "P K"]
    inverse_pdf: Float[Tensor, "P K"]
    toward_light: Float[Tensor, "P K 3"]

    @classmethod
    def empty(cls, count: int, samples: int, device: torch.device) -> TracedLobes:
        """With values that are not set."""

        def unset(*shape: int) -> Tensor:
            return torch.empty(count, samples, *shape, device=device)

        return cls(*_empty_texels(count, samples, device), unset(), unset(), unset(), unset(), unset(), unset(3))


def traced_lobes(
    tracer: RayTracer,
    frames: DirectionFrames,
    toward_eye: Float[Tensor, "P 3"],
    alpha: Float[Tensor, "P 1"],
    square: Float[Tensor, "P K 2"],
    face_cells: NDArray[np.int64],
    pyramid: Pyramid,
    rotation: Float[Tensor, "N 3 3"] | None,
    metal: MetalSurface | None = None,
    seed: int = 0,
) -> TracedLobes:
    """Visible normals for points (angle, area) of the unit square, and what their reflections see.

    `toward_eye` is unit, in the axes of the frames and above the horizon. `rotation` (per view) rotates directions of
    the world into the light's own frame. Directions that hit `metal` are reflected there, with random numbers of
    `seed`; without it they read the cache cell that they hit.
    """
    count, samples, _ = square.shape
    found = TracedLobes.empty(count, samples, square.device)
    cells = mi.Int32(face_cells.astype(np.int32))
    for part in _launches(square):
        lobes = frames.part(part), toward_eye[part], alpha[part], square[part]
        beyond = None if metal is None else (metal, part.start * samples, seed)
        launched = _launched_lobes(tracer, *lobes, cells, pyramid, rotation, beyond)
        for target, values in zip(found, launched, strict=True):
            copy_to_torch(values, target[part])
    return found


def _launched_lobes(
    tracer: RayTracer,
    frames: DirectionFrames,
    toward_eye: Float[Tensor, "P 3"],
    alpha: Float[Tensor, "P 1"],
    square: Float[Tensor, "P K 2"],
    cells: DrJitArray,
    pyramid: Pyramid,
    rotation: Float[Tensor, "N 3 3"] | None,
    beyond: tuple[MetalSurface, int, int] | None,
) -> tuple[DrJitArray, ...]:
    """The flat arrays of `TracedLobes`. `beyond`: the metal, the number of the first direction and the seed."""
    samples = square.shape[1]
    row, drawn = _rows_and_points(square)
    eye: DrJitArray = dr.gather(mi.Vector3f, to_float(toward_eye, mi), row)
    width = clamped_alpha(dr.gather(mi.Float, to_float(alpha, mi), row))
    half = visible_normal(eye, width, mi.Point2f(drawn.y, drawn.x))
    half_eye = dr.clip(dr.dot(half, eye), 0, 1)
    light = 2 * half_eye * half - eye
    inverse: DrJitArray = dr.rcp(samples * dr.maximum(visible_lobe(half, eye, width), MIN_DENSITY))
    above = light.z > 0
    ray = _ray(frames, row, light)
    hit = tracer.scene.ray_intersect_preliminary(ray, coherent=False, active=above)
    blocked = hit.is_valid() & above
    cell = dr.gather(mi.Int32, cells, hit.prim_index, blocked)
    columns, weights = light_texels(pyramid, _in_frame_of_light(ray.d, frames, row, rotation), inverse)
    columns = dr.select(blocked, mi.Vector4i(pyramid.texels + cell), columns)
    weights = dr.select(blocked, mi.Vector4f(BILINEAR_OF_CELL), weights)
    texels, bilinear = dr.ravel(columns), dr.ravel(weights)
    if beyond is not None:
        metal, first, seed = beyond
        ends = reflected_ends(tracer, metal, cells, ray, hit, blocked, first, seed)
        if ends is not None:
            assert rotation is None, "a light that moves with the camera has no reflections"
            column = _column_of_end(pyramid, ends, samples, len(metal.brightness))
            dr.scatter(texels, column, ends.entry)
            dr.scatter(bilinear, ends.weight / SPLIT, ends.entry)
    inverse = dr.select(above, inverse, 0)
    sine = dr.square(half.x) + dr.square(half.y)
    found = texels, bilinear, light.z, half.z, sine, half_eye, inverse, dr.ravel(light)
    dr.eval(found)  # one kernel: each result that is read alone would trace the rays again
    return found


def _column_of_end(pyramid: Pyramid, ends: ReflectedEnds, samples: int, cells: int) -> DrJitArray:
    """The source that each reflected direction reads: one of four texels, with their weights as probabilities."""
    solid_angle = dr.rcp(samples * dr.maximum(ends.density, MIN_DENSITY))
    texels, weights = light_texels(pyramid, ends.direction, solid_angle)
    column, passed = texels.x, weights.x
    for texel, weight in ((texels.y, weights.y), (texels.z, weights.z), (texels.w, weights.w)):
        column = dr.select(ends.drawn > passed, texel, column)
        passed += weight
    column = dr.select(ends.blocked, pyramid.texels + ends.cell, column)
    return column + mi.Int32(ends.reflections) * (pyramid.texels + cells)


def traced_hemispheres(
    tracer: RayTracer,
    frames: DirectionFrames,
    square: Float[Tensor, "P K 2"],
    pyramid: Pyramid,
    rotation: Float[Tensor, "N 3 3"],
) -> tuple[Int[Tensor, "P 4K"], Float[Tensor, "P 4K"]]:
    """Texels of the pyramid and their weights in each point's irradiance.

    Directions follow the cosine; those that hit the surface have no weight. Each reads the level whose texels are as
    large as its share of the hemisphere.
    """
    count, samples, _ = square.shape
    columns, weights = _empty_texels(count, samples, square.device)
    for part in _launches(square):
        launched = _launched_hemispheres(tracer, frames.part(part), square[part], pyramid, rotation)
        for target, values in zip((columns, weights), launched, strict=True):
            copy_to_torch(values, target[part])
    return columns, weights


def _launched_hemispheres(
    tracer: RayTracer,
    frames: DirectionFrames,
    square: Float[Tensor, "P K 2"],
    pyramid: Pyramid,
    rotation: Float[Tensor, "N 3 3"],
) -> tuple[DrJitArray, DrJitArray]:
    """Columns and weights as flat arrays."""
    share = math.pi / square.shape[1]
    row, drawn = _rows_and_points(square)
    radius, cosine = dr.sqrt(drawn.y), dr.safe_sqrt(1 - drawn.y)
    sine_of_turn, cosine_of_turn = dr.sincos(dr.two_pi * drawn.x)
    ray = _ray(frames, row, mi.Vector3f(radius * cosine_of_turn, radius * sine_of_turn, cosine))
    solid_angle: DrJitArray = dr.rcp(dr.maximum(cosine, MIN_HEMISPHERE_COSINE)) * share
    columns, weights = light_texels(pyramid, _in_frame_of_light(ray.d, frames, row, rotation), solid_angle)
    weights *= dr.select(tracer.scene.ray_test(ray), mi.Float(0), share)
    found = dr.ravel(columns), dr.ravel(weights)
    dr.eval(found)
    return found


def _empty_texels(
    count: int, samples: int, device: torch.device
) -> tuple[Int[Tensor, "P 4*K"], Float[Tensor, "P 4*K"]]:
    """Columns and weights of four texels for each direction, with values that are not set."""
    columns = torch.empty(count, 4 * samples, dtype=torch.int32, device=device)
    return columns, torch.empty(count, 4 * samples, device=device)


def _launches(square: Float[Tensor, "P K 2"]) -> list[slice]:
    """Ranges of points with at most `LANES` directions."""
    count, samples, _ = square.shape
    step = max(LANES // samples, 1)
    return [slice(start, min(start + step, count)) for start in range(0, count, step)]


def _rows_and_points(square: Float[Tensor, "P K 2"]) -> tuple[DrJitArray, DrJitArray]:
    """The row of each direction, and its point of the unit square."""
    count, samples, _ = square.shape
    lane = dr.arange(mi.UInt32, count * samples)
    return lane // samples, dr.gather(mi.Vector2f, to_float(square, mi), lane)


def _ray(frames: DirectionFrames, row: DrJitArray, local: DrJitArray) -> DrJitArray:
    """Rays along directions in the axes of the frames."""
    axes = to_float(frames.axes, mi)
    tangent, bitangent, normal = (dr.gather(mi.Vector3f, axes, row * 3 + axis) for axis in range(3))
    world = local.x * tangent + local.y * bitangent + local.z * normal
    return mi.Ray3f(dr.gather(mi.Point3f, to_float(frames.origin, mi), row), world)


def _in_frame_of_light(
    world: DrJitArray, frames: DirectionFrames, row: DrJitArray, rotation: Float[Tensor, "N 3 3"] | None
) -> DrJitArray:
    if rotation is None:
        return world
    table, view = to_float(rotation, mi), dr.gather(mi.UInt32, to_uint(frames.view, mi), row)
    return mi.Vector3f(*(dr.dot(dr.gather(mi.Vector3f, table, view * 3 + axis), world) for axis in range(3)))


def light_texels(pyramid: Pyramid, toward: DrJitArray, solid_angle: DrJitArray) -> tuple[DrJitArray, DrJitArray]:
    """Texels of `Pyramid.flatten` and their bilinear weights, as Vector4i and Vector4f, for directions.

    Each reads the level of its solid angle.
    """
    u, v = latlong_coordinates(toward)
    texel = 2 * math.pi**2 / (pyramid.height * pyramid.width) * dr.maximum(dr.sin(dr.pi * v), 1e-3)
    wanted = 0.5 * dr.log2(dr.maximum(solid_angle / texel, 1e-12)) + LEVEL_OFFSET
    level = mi.UInt32(dr.clip(dr.round(wanted), 0, len(pyramid.shapes) - 1))
    sizes = np.array([(h, w, h * w) for h, w in pyramid.shapes], np.int32)
    heights, widths = (dr.gather(mi.Int32, mi.Int32(np.ascontiguousarray(sizes[:, k])), level) for k in range(2))
    first = dr.gather(mi.Int32, mi.Int32((sizes[:, 2].cumsum() - sizes[:, 2]).astype(np.int32)), level)
    x: AxisNeighbours = repeated(u * mi.Float(widths) - 0.5, widths)
    y: AxisNeighbours = extended(v * mi.Float(heights) - 0.5, heights)
    above, below = first + y.low * widths, first + y.high * widths
    columns = mi.Vector4i(above + x.low, above + x.high, below + x.low, below + x.high)
    fx, fy = x.fraction, y.fraction
    weights = mi.Vector4f((1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy)
    return columns, weights
