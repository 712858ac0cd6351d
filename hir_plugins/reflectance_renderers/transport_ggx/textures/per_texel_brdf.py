"""A BRDF for every texel, for materials that vary from texel to texel, such as the threads of a fabric.

Under the light of a fit, the BRDF of a point follows from its own photographs (`brdf_fit.py`). Such points are the
texels of the maps, and the pixels of held-out views, which evaluate the model before any texture is made.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import torch
from hir_exporters.metallic_parameters import DEFAULT_DIELECTRIC_F0
from jaxtyping import Float
from torch import Tensor

from hir_core.mesh.texel_rasterization import TexelSurface
from hir_core.plugins.model_spec import ModelSpec
from hir_plugins.reflectance_renderers.brdf_torch import Model
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.observed_pixels import ObservedPixels
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.operator.probe_lookup import ProbeTable
from hir_plugins.reflectance_renderers.transport_ggx.operator.radiance_probes import build_probes
from hir_plugins.reflectance_renderers.transport_ggx.textures.brdf_fit import PointBrdfFit
from hir_plugins.reflectance_renderers.transport_ggx.textures.brdf_fit_state import (
    FROZEN_WEIGHT,
    ObservedPoints,
    PointBrdfs,
    Priors,
    ShadingPoints,
)
from hir_plugins.reflectance_renderers.transport_ggx.textures.observations import ImageCache, observe

OBSERVATIONS_PER_CHUNK = 3_000_000
"""Points times photographs in memory: some 60 MB, with the equations of the points."""
OBSERVATIONS_PER_POINT = 30
"""Memory of a point without its photographs (two states and their equations), in observations."""
GLOSSY_SPECULAR_SHARE, GLOSSY_ALPHA = 1 / 3, 0.33
"""The second initial guess of a point has this share of its colour in a lobe of this α: metal and paint are two minima
of the cost."""
MAX_GUESSED_METALNESS = 0.95
"""The second initial guess of a `metallic` point is not nearer to a metal or to a dielectric."""
MIN_OBSERVATIONS = 4
"""A point with fewer photographs takes the BRDF of the fit at vertices."""


@dataclass(frozen=True, eq=False)
class LitSurface:
    """A surface under the light of a fit, and the photographs of it."""

    transport: Transport
    images: ImageCache
    views: Sequence[int]
    spec: ModelSpec
    parameters: Parameters
    probes: Sequence[ProbeTable]
    """Of the light of each take."""
    sources: Float[Tensor, "TS 3"]
    irradiance: Float[Tensor, "TC 3"]
    vectors: Float[Tensor, "TC 3 3"]

    @classmethod
    def of(
        cls, transport: Transport, images: ImageCache, views: Sequence[int], spec: ModelSpec, parameters: Parameters
    ) -> LitSurface:
        """Filters the light of a fit into radiance probes."""
        with torch.no_grad():
            sources, irradiance = transport.sources(parameters.radiance, parameters.base_color, spec.bounces)
            vectors = transport.vector_irradiance(parameters.radiance)
            texels = transport.pyramid.texels
            probes = [
                ProbeTable(build_probes(transport, block[transport.level], block[texels:]))
                for block in sources.chunk(transport.takes.count)
            ]
        return cls(transport, images, views, spec, parameters, probes, sources, irradiance, vectors)

    @property
    def model(self) -> Model:
        """BRDF model of the points."""
        return "dielectric" if self.spec.brdf == "diffuse" else self.spec.brdf

    @property
    def dielectric_f0(self) -> float:
        """F0 of the dielectric part of `metallic`; not used by other BRDFs."""
        return float(self.parameters.dielectric_f0) if self.model == "metallic" else DEFAULT_DIELECTRIC_F0

    def with_parameters(self, parameters: Parameters) -> LitSurface:
        """The same surface under the light of other parameters."""
        return LitSurface.of(self.transport, self.images, self.views, self.spec, parameters)

    def solve(
        self, face: Tensor, barycentric: Tensor, position: Tensor, normal: Tensor, all_parameters: bool
    ) -> tuple[PointBrdfFit, PointBrdfs, Float[Tensor, " P"]]:
        """The BRDFs of points, and the number of photographs that see each; without `all_parameters` only their albedos
        are solved.
        """
        surface = self.transport.surface
        corners = surface.faces[face]
        cell = self.transport.irradiance_cache.of_vertex[corners]
        nearest = cell.gather(1, barycentric.argmax(dim=1, keepdim=True))[:, 0]
        exposure, face_normals, takes = self.parameters.exposure, surface.face_normals[face], []
        for number, probes in enumerate(self.probes):
            at = cell + number * len(self.transport.irradiance_cache)
            irradiance = (self.irradiance[at] * barycentric[..., None]).sum(dim=1)
            vectors = (self.vectors[at] * barycentric[..., None, None]).sum(dim=1)
            points = ShadingPoints(position, normal, nearest, irradiance, vectors)
            views = self.transport.takes.views_of(number, self.views)
            observed = observe(self.transport, self.images, views, exposure, position, face_normals)
            takes.append(ObservedPoints(points, observed, probes))
        fit = PointBrdfFit(takes, self.model, self._priors(all_parameters), self.dielectric_f0)
        start = self._start(corners, barycentric)
        count = sum((each.observations.count for each in takes), torch.zeros_like(position[:, 0]))
        brdfs, cost = fit.solve(start)
        if all_parameters:
            second = _glossy(takes, start)
            if self.model == "metallic":
                second = self._other_metalness(second, start)
            glossy, glossy_cost = fit.solve(second)
            brdfs = glossy.where(glossy_cost < cost, brdfs)
            brdfs = brdfs.where(count >= MIN_OBSERVATIONS, start)
        return fit, brdfs, count

    def _priors(self, all_parameters: bool) -> Priors:
        if self.model != "metallic":
            return Priors() if all_parameters else Priors.of_albedo()
        if not all_parameters:
            return Priors.of_base_color()
        return Priors(metalness=FROZEN_WEIGHT) if self.spec.metalness == "metal" else Priors()

    def _other_metalness(self, glossy: PointBrdfs, start: PointBrdfs) -> PointBrdfs:
        """The second initial guess of `metallic`: the mean colour, as a wide metal where the first is a dielectric, and
        as a dielectric where it is a metal, unless all is metal.
        """
        metal = torch.ones_like(start.metalness)
        if self.spec.metalness == "map":
            metal = 1 - start.metalness.clamp(1 - MAX_GUESSED_METALNESS, MAX_GUESSED_METALNESS)
        base = (glossy.albedo + glossy.specular).clamp(0, 1)
        albedo, specular = (1 - metal) * base, (1 - metal) * self.dielectric_f0 + metal * base
        alpha = torch.where(metal > 0.5, glossy.alpha, start.alpha)
        return PointBrdfs(albedo, specular, alpha, glossy.normal_offset, metal)

    def _start(self, corners: Tensor, barycentric: Tensor) -> PointBrdfs:
        """The fit at vertices."""

        def at(values: Tensor) -> Tensor:
            if len(values) == 1:
                return values.expand(len(corners), -1)
            return (values[corners] * barycentric[..., None]).sum(dim=1)

        return PointBrdfs(
            at(self.parameters.diffuse_albedo),
            at(self.parameters.specular_albedo).expand(-1, 3),
            at(self.parameters.alpha),
            torch.zeros_like(barycentric)
            if self.parameters.normal_offset is None
            else at(self.parameters.normal_offset),
            torch.zeros_like(barycentric[:, :1])
            if self.parameters.metalness is None
            else at(self.parameters.metal_share),
        )


def _glossy(takes: Sequence[ObservedPoints], start: PointBrdfs) -> PointBrdfs:
    """The second initial guess: a share of each point's mean colour in a wide lobe."""
    seen = [each.observations for each in takes]
    total = sum(((each.color * each.weight[..., None]).sum(dim=0) for each in seen), torch.zeros_like(start.albedo))
    weights = [each.weight.sum(dim=0)[:, None] for each in seen]
    weight = sum(weights, torch.zeros_like(start.alpha))
    mean, irradiance = total / weight.clamp_min(1e-6), takes[0].points.irradiance
    if len(takes) > 1:
        arriving = (w * each.points.irradiance for w, each in zip(weights, takes, strict=True))
        irradiance = sum(arriving, torch.zeros_like(mean)) / weight.clamp_min(1e-6)
    albedo = mean / (irradiance / torch.pi).clamp_min(0.05)
    return PointBrdfs(
        ((1 - GLOSSY_SPECULAR_SHARE) * albedo).clamp(0.02, 0.95),
        (GLOSSY_SPECULAR_SHARE * albedo).clamp(0.02, 0.8),
        torch.full_like(start.alpha, GLOSSY_ALPHA),
        torch.zeros_like(start.normal_offset),
        start.metalness,
    )


def pixel_brdfs(lit: LitSurface, pixels: ObservedPixels, all_parameters: bool = True) -> PointBrdfs:
    """The BRDFs of the points behind pixels, from the photographs of `lit` alone; without `all_parameters` only their
    albedos are solved.
    """
    none = pixels.color[:0]
    brdfs = [PointBrdfs(none, none, none[:, :1], none, none[:, :1])]
    for rows in _parts(len(pixels), len(lit.views)):
        points = pixels.points.take(rows)
        brdfs.append(lit.solve(points.face, points.barycentric, points.position, points.normal, all_parameters)[1])
    return PointBrdfs.join(brdfs)


def texel_brdfs(
    lit: LitSurface, texels: TexelSurface, report: Callable[[float], None]
) -> tuple[PointBrdfs, Float[Tensor, " N"]]:
    """The BRDFs of the N texels of an atlas, and the number of photographs that see each."""
    brdfs, count, done = [], [], 0
    for rows in _parts(len(texels.face), len(lit.views)):
        _, values, seen = lit.solve(
            texels.face[rows], texels.barycentric[rows], texels.position[rows], texels.normal[rows], True
        )
        brdfs.append(values)
        count.append(seen)
        done += len(rows)
        report(done / len(texels.face))
    return PointBrdfs.join(brdfs), torch.cat(count)


def _parts(points: int, views: int) -> Iterator[Tensor]:
    if points:
        yield from torch.arange(points).split(max(1, OBSERVATIONS_PER_CHUNK // (views + OBSERVATIONS_PER_POINT)))
