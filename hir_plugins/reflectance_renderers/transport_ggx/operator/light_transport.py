"""What is computed once for frozen geometry: acceleration structure, irradiance cache, irradiance matrices."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy.typing import NDArray
from torch import Tensor

from hir_core.optimization.linear_maps import LinearMap
from hir_core.scene import Mesh
from hir_plugins.reflectance_renderers.ray_tracer import RayTracer
from hir_plugins.reflectance_renderers.transport_ggx.operator.diffuse_transport import (
    DiffuseTransport,
    diffuse_transport,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.irradiance_cache import (
    IrradianceCache,
    build_irradiance_cache,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_pyramid import Pyramid, texel_directions
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.metal_reflections import (
    MAX_REFLECTIONS,
    METAL_FROM,
    MIN_BRIGHTNESS,
    MetalSurface,
    metal_color,
    sources_by_reflections,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.specular_lobes import Lobes, trace_lobes
from hir_plugins.reflectance_renderers.transport_ggx.operator.take_lights import (
    ONE_LIGHT,
    TakeLights,
    light_of_each_take,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import Surface, SurfacePoints, refine

RAY_OFFSET = 1e-3
"""Distance of ray origins from the surface, as a fraction of the object's radius."""


@dataclass(frozen=True, eq=False)
class Transport:
    """Cached light transport of one surface."""

    surface: Surface
    tracer: RayTracer
    irradiance_cache: IrradianceCache
    face_cells: NDArray[np.int64]
    """The cache cell that represents each face."""
    pyramid: Pyramid
    level: slice
    """Rows of the flattened pyramid that `diffuse` multiplies."""
    diffuse: DiffuseTransport
    offset: float
    cell_average: LinearMap
    """Matrix (C, V) that averages vertex values over each cache cell."""
    takes: TakeLights = ONE_LIGHT
    """The lights of the photographs. Of T lights the images are one below another: TH is T·H rows, TS is T·S sources,
    TC is T·C cells."""

    @property
    def source_count(self) -> int:
        """Pyramid texels and cache cells of one light."""
        return self.pyramid.texels + len(self.irradiance_cache)

    def lights(self, radiance: Float[Tensor, "TH W 3"]) -> tuple[Float[Tensor, "H W 3"], ...]:
        """The image of each take's light."""
        return light_of_each_take(radiance, self.takes.count)

    def cells_at(self, points: SurfacePoints) -> Int[Tensor, "P 3"]:
        """The cache cells of the corners around each point, in the block of its take."""
        cells = self.irradiance_cache.of_vertex[self.surface.faces[points.face]]
        return self.takes.stacked_columns(cells, points.view, len(self.irradiance_cache))

    def interpolation(self, points: SurfacePoints) -> tuple[LinearMap, LinearMap]:
        """Matrices that interpolate vertex values and cache cells at points."""
        corners = self.surface.faces[points.face]
        weights = points.barycentric
        vertices = LinearMap.from_rows(corners, weights, len(self.surface.positions))
        cells = self.takes.count * len(self.irradiance_cache)
        return vertices, LinearMap.from_rows(self.cells_at(points), weights, cells)

    def sources(
        self,
        radiance: Float[Tensor, "TH W 3"],
        albedo: Float[Tensor, "V 3"],
        bounces: int,
        metalness: Float[Tensor, "#V 1"] | None = None,
    ) -> tuple[Float[Tensor, "TS 3"], Float[Tensor, "TC 3"]]:
        """Radiance of all that a ray can hit (pyramid texels, then cache cells), and the irradiance of every cell.

        With `metalness` and bounces there is a block of the radiance for each number of reflections by metal, whose
        base colour is `albedo`: those that the lobes of a `metal_surface` read.
        """
        found = [self._sources(light, albedo, bounces) for light in self.lights(radiance)]
        if metalness is not None and bounces:
            color, reflections = metal_color(albedo, metalness), min(bounces, MAX_REFLECTIONS)
            found = [(sources_by_reflections(seen, color, reflections), irradiance) for seen, irradiance in found]
        return _stacked([sources for sources, _ in found]), _stacked([irradiance for _, irradiance in found])

    def _sources(
        self, radiance: Float[Tensor, "H W 3"], albedo: Float[Tensor, "V 3"], bounces: int
    ) -> tuple[Float[Tensor, "S 3"], Float[Tensor, "C 3"]]:
        """The block of one light."""
        pyramid = self.pyramid.flatten(radiance)
        direct = self.diffuse.sky @ pyramid[self.level]
        if not bounces:
            return torch.cat([pyramid, torch.zeros_like(direct)]), direct
        cell_albedo = self.cell_average @ albedo
        irradiance = seen = direct
        for _ in range(bounces):
            seen = irradiance
            irradiance = direct + self.diffuse.bounce @ (cell_albedo * seen / torch.pi)
        # what a reflection shows has one bounce less than the surface that reflects it
        return torch.cat([pyramid, cell_albedo * seen / torch.pi]), irradiance

    @cached_property
    def _vector_sky(self) -> LinearMap:
        """(3C, T): as `diffuse.sky`, with the direction towards the light in place of the cosine."""
        sky = self.diffuse.sky.matrix
        height, width = next(shape for shape in self.pyramid.shapes if shape[0] * shape[1] == sky.shape[1])
        directions = texel_directions(height, width).to(sky.device)
        cosine = (self.irradiance_cache.normals @ directions.T).clamp_min(1e-6)
        matrix = torch.cat([sky / cosine * directions[:, axis] for axis in range(3)])
        return LinearMap(matrix, matrix.T.contiguous())

    def vector_irradiance(self, radiance: Float[Tensor, "TH W 3"]) -> Float[Tensor, "TC 3 3"]:
        """Vector irradiance of each cell from direct light (Gershun 1939): axes first, then colours."""
        cells = len(self.irradiance_cache)
        vectors = [self._vector_sky @ self.pyramid.flatten(light)[self.level] for light in self.lights(radiance)]
        return _stacked([each.reshape(3, cells, 3).transpose(0, 1) for each in vectors])

    def sky_only(self, radiance: Float[Tensor, "TH W 3"]) -> Float[Tensor, "TS 3"]:
        """Radiance of all that a ray can hit, without light reflected by the surface."""
        black = radiance.new_zeros(len(self.irradiance_cache), radiance.shape[2])
        return _stacked([torch.cat([self.pyramid.flatten(light), black]) for light in self.lights(radiance)])

    def lobes(
        self,
        points: SurfacePoints,
        alpha: Float[Tensor, "#P 1"],
        samples: int,
        rotation: Float[Tensor, "N 3 3"] | None = None,
        seed: int = 0,
        metal: MetalSurface | None = None,
    ) -> Lobes:
        """The specular lobe of each point; with `metal` it reads the blocks of the sources."""
        cells = self.face_cells, len(self.irradiance_cache)
        lobes = trace_lobes(
            self.tracer, points, *cells, alpha, samples, self.pyramid, self.offset, rotation, seed, metal
        )
        columns = self.takes.stacked_columns(lobes.columns, points.view, lobes.sources)
        return replace(lobes, columns=columns, sources=self.takes.count * lobes.sources)

    def metal_surface(
        self,
        base_color: Float[Tensor, "V 3"],
        alpha: Float[Tensor, "#V 1"],
        metalness: Float[Tensor, "#V 1"],
        bounces: int,
    ) -> MetalSurface | None:
        """The metal by which directions of lobes are reflected, at most `bounces` times; None without bounces."""
        if not bounces:
            return None
        count = len(self.surface.positions)
        with torch.no_grad():
            color, width, share = (
                self.cell_average @ values.expand(count, -1).contiguous() for values in (base_color, alpha, metalness)
            )
            brightness = torch.where(share[:, 0] >= METAL_FROM, color.mean(dim=1), -1.0)
            mean = float(metal_color(base_color, metalness).mean().clamp_min(MIN_BRIGHTNESS))
        surface, reflections = self.surface, min(bounces, MAX_REFLECTIONS)
        return MetalSurface(surface.normals, surface.faces, self.offset, brightness, width[:, 0], mean, reflections)


def _stacked(blocks: list[Tensor]) -> Tensor:
    return blocks[0] if len(blocks) == 1 else torch.cat(blocks)


def build_transport(
    mesh: Mesh, vertices: int, max_cells: int, environment: tuple[int, int], diffuse_rows: int, device: str
) -> Transport:
    """Traces the irradiance matrices of a mesh for a light of `environment` = (height, width) texels."""
    surface = refine(mesh, vertices)
    center = (surface.positions.max(dim=0).values + surface.positions.min(dim=0).values) / 2
    radius = float((surface.positions - center).norm(dim=1).max())
    tracer = RayTracer(surface.positions.cpu().numpy(), surface.faces.cpu().numpy().astype(np.int32), device)
    cache = build_irradiance_cache(surface, max_cells)
    face_cells = cache.of_vertex[surface.faces[:, 0]].cpu().numpy()
    pyramid = Pyramid(*environment)
    offset = RAY_OFFSET * max(radius, 1e-30)
    start = 0
    for height, width in pyramid.shapes:
        if height <= diffuse_rows:
            break
        start += height * width
    diffuse = diffuse_transport(tracer, cache, face_cells, height, width, offset)
    level = slice(start, start + height * width)
    count = torch.bincount(cache.of_vertex, minlength=len(cache)).clamp_min(1).float()
    share = (1 / count)[cache.of_vertex]
    average = LinearMap.from_rows(cache.of_vertex[:, None], share[:, None], len(cache)).T
    return Transport(surface, tracer, cache, face_cells, pyramid, level, diffuse, offset, average)
