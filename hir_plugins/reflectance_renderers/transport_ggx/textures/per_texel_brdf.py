"""A lobe for every texel: where the material changes from thread to thread, its photographs tell each texel's own.

Under the light of a fit the values of a point follow from its photographs alone (`point_lobes.py`); the texels of the
maps are such points, and so are the pixels of held-out views, which judge before any texture is made.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.mesh.texel_rasterization import TexelSurface
from hir_core.plugins.model_spec import ModelSpec
from hir_plugins.reflectance_renderers.brdf_torch import Model
from hir_plugins.reflectance_renderers.transport_ggx.fit.observed_pixels import Photographed
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Unknowns
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.operator.probe_lookup import ProbeTable
from hir_plugins.reflectance_renderers.transport_ggx.operator.radiance_probes import make_probes
from hir_plugins.reflectance_renderers.transport_ggx.textures.brdf_fit import Holds, PointFit, Points, PointValues
from hir_plugins.reflectance_renderers.transport_ggx.textures.observations import Pictures, Sightings, sightings

SIGHTINGS_AT_ONCE = 3_000_000
"""Points times photographs in memory: some 60 MB, a point's own equations included."""
POINT_SIGHTINGS = 30
"""Sightings that take as much memory as what is kept of a point: two states and their equations."""
GLOSS_SHARE, GLOSS_ALPHA = 1 / 3, 0.33
"""The other start of a point: a share of its colour in a wide lobe. Metal and paint lie in two valleys."""
FEWEST_SIGHTS = 4
"""Photographs below which a point tells nothing of its own lobe."""


@dataclass(frozen=True, eq=False)
class LitSurface:
    """A surface under the light of a fit, and the photographs that tell of it."""

    transport: Transport
    pictures: Pictures
    views: Sequence[int]
    spec: ModelSpec
    unknowns: Unknowns
    probes: ProbeTable
    sources: Float[Tensor, "S 3"]
    irradiance: Float[Tensor, "C 3"]
    vectors: Float[Tensor, "C 3 3"]

    @classmethod
    def of(
        cls, transport: Transport, pictures: Pictures, views: Sequence[int], spec: ModelSpec, unknowns: Unknowns
    ) -> LitSurface:
        """Filters the light of a fit."""
        with torch.no_grad():
            sources, irradiance = transport.sources(unknowns.radiance, unknowns.diffuse_albedo, spec.bounces)
            vectors = transport.vector_irradiance(unknowns.radiance)
            probes = ProbeTable(make_probes(transport, sources[transport.level], sources[transport.pyramid.texels :]))
        return cls(transport, pictures, views, spec, unknowns, probes, sources, irradiance, vectors)

    @property
    def model(self) -> Model:
        """Of its lobes."""
        return "paper" if self.spec.brdf == "paper" else "dielectric"

    def under(self, unknowns: Unknowns) -> LitSurface:
        """The same surface in another light."""
        return LitSurface.of(self.transport, self.pictures, self.views, self.spec, unknowns)

    def solve(
        self, face: Tensor, barycentric: Tensor, position: Tensor, normal: Tensor, own_lobes: bool
    ) -> tuple[PointFit, PointValues, Sightings]:
        """The values of points; of their albedos alone where they are not to have their `own_lobes`."""
        surface, cells = self.transport.surface, self.transport.cells
        corners = surface.faces[face]
        cell = cells.of_vertex[corners]
        lit = (self.irradiance[cell] * barycentric[..., None]).sum(dim=1)
        around = (self.vectors[cell] * barycentric[..., None, None]).sum(dim=1)
        nearest = cell.gather(1, barycentric.argmax(dim=1, keepdim=True))[:, 0]
        seen = sightings(
            self.transport, self.pictures, self.views, self.unknowns.exposure, position, surface.face_normals[face]
        )
        points = Points(position, normal, nearest, lit, around)
        fit = PointFit(points, seen, self.probes, self.model, Holds() if own_lobes else Holds.of_albedo())
        start = self._start(corners, barycentric)
        found, cost = fit.solve(start)
        if own_lobes:
            glossy, dearness = fit.solve(_glossy(seen, lit, start))
            found = glossy.where(dearness < cost, found)
            found = found.where(seen.count >= FEWEST_SIGHTS, start)
        return fit, found, seen

    def _start(self, corners: Tensor, barycentric: Tensor) -> PointValues:
        """What the fit at vertices has there, with the mesh's normals: no rung has both a normal map and this."""

        def at(values: Tensor) -> Tensor:
            if len(values) == 1:
                return values.expand(len(corners), -1)
            return (values[corners] * barycentric[..., None]).sum(dim=1)

        return PointValues(
            at(self.unknowns.diffuse_albedo),
            at(self.unknowns.specular_albedo).expand(-1, 3),
            at(self.unknowns.alpha),
            torch.zeros_like(barycentric),
        )


def _glossy(seen: Sightings, irradiance: Float[Tensor, "P 3"], start: PointValues) -> PointValues:
    """A share of each point's mean colour in a wide lobe."""
    total = (seen.color * seen.weight[..., None]).sum(dim=0)
    mean = total / seen.weight.sum(dim=0).clamp_min(1e-6)[:, None]
    albedo = mean / (irradiance / torch.pi).clamp_min(0.05)
    return PointValues(
        ((1 - GLOSS_SHARE) * albedo).clamp(0.02, 0.95),
        (GLOSS_SHARE * albedo).clamp(0.02, 0.8),
        torch.full_like(start.alpha, GLOSS_ALPHA),
        torch.zeros_like(start.tilt),
    )


def shown_pixels(lit: LitSurface, pixels: Photographed, own_lobes: bool) -> Float[Tensor, "P 3"]:
    """Linear radiance of pixels, shown by points that the photographs of `lit` alone have taught."""
    shown = [torch.zeros_like(pixels.color[:0])]
    for rows in _parts(len(pixels), len(lit.views)):
        points = pixels.points.take(rows)
        fit, found, _ = lit.solve(points.face, points.barycentric, points.position, points.normal, own_lobes)
        shown.append(fit.shown(found, points.to_eye))
    return torch.cat(shown)


def pixel_values(lit: LitSurface, pixels: Photographed) -> PointValues:
    """The values of the points that pixels show."""
    found = []
    for rows in _parts(len(pixels), len(lit.views)):
        points = pixels.points.take(rows)
        found.append(lit.solve(points.face, points.barycentric, points.position, points.normal, True)[1])
    return PointValues.join(found)


def texel_values(
    lit: LitSurface, texels: TexelSurface, report: Callable[[float], None]
) -> tuple[PointValues, Float[Tensor, " N"]]:
    """The values of the N texels of an atlas, and how many photographs told of each."""
    found, count, done = [], [], 0
    for rows in _parts(len(texels.face), len(lit.views)):
        _, values, seen = lit.solve(
            texels.face[rows], texels.barycentric[rows], texels.position[rows], texels.normal[rows], True
        )
        found.append(values)
        count.append(seen.count)
        done += len(rows)
        report(done / len(texels.face))
    return PointValues.join(found), torch.cat(count)


def _parts(points: int, views: int) -> Iterator[Tensor]:
    if points:
        yield from torch.arange(points).split(max(1, SIGHTINGS_AT_ONCE // (views + POINT_SIGHTINGS)))
