"""The data of the per-point BRDF fit: points with the light at each, their BRDFs, priors, and the state (Dr.Jit)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import drjit as dr
import mitsuba as mi
import torch
from hir_exporters.metallic_parameters import DEFAULT_DIELECTRIC_F0
from jaxtyping import Float, Int
from torch import Tensor

from hir_plugins.reflectance_renderers.brdf_torch import Model
from hir_plugins.reflectance_renderers.drjit_arrays import to_float, to_uint
from hir_plugins.reflectance_renderers.drjit_srgb import linear_to_srgb
from hir_plugins.reflectance_renderers.drjit_types import DrJitArray
from hir_plugins.reflectance_renderers.transport_ggx.operator.probe_lookup import TEXELS_PER_PROBE, ProbeTable
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import tangent_frame
from hir_plugins.reflectance_renderers.transport_ggx.textures.observations import Observations

FROZEN_WEIGHT = 1e8
"""Weight of a prior that no photograph can change."""
MIN_SPECULAR_ALBEDO = 0.002
"""Lower limit of ρs: at 0 the derivative in α and in the normal vanishes."""


@dataclass(frozen=True, eq=False)
class ShadingPoints:
    """P points and the light at each."""

    position: Float[Tensor, "P 3"]
    normal: Float[Tensor, "P 3"]
    """Of the mesh; unit."""
    cell: Int[Tensor, " P"]
    """The cache cell whose radiance probe is used."""
    irradiance: Float[Tensor, "P 3"]
    vectors: Float[Tensor, "P 3 3"]
    """Vector irradiance: axes first, then colours (`operator/shading_normals.py`)."""


@dataclass(frozen=True, eq=False)
class ObservedPoints:
    """Points under the light of one take, and the photographs of that take."""

    points: ShadingPoints
    observations: Observations
    probes: ProbeTable


@dataclass(frozen=True, eq=False)
class PointBrdfs:
    """The BRDF of each point."""

    albedo: Float[Tensor, "P 3"]
    specular: Float[Tensor, "P 3"]
    alpha: Float[Tensor, "P 1"]
    normal_offset: Float[Tensor, "P 3"]
    """In the world (`operator/shading_normals.py`)."""
    metalness: Float[Tensor, "P 1"]
    """Of `metallic`, whose albedos follow from it and the base colour; 0 for other BRDFs."""

    def where(self, chosen: Tensor, other: PointBrdfs) -> PointBrdfs:
        """These where `chosen` (P,) is true, `other` elsewhere."""
        pairs = zip(self.all(), other.all(), strict=True)
        return PointBrdfs(*(torch.where(chosen[:, None], mine, others) for mine, others in pairs))

    def take(self, rows: Tensor) -> PointBrdfs:
        """Those of the points of `rows`."""
        return PointBrdfs(*(value[rows] for value in self.all()))

    def all(self) -> tuple[Tensor, ...]:
        """Albedo, ρs, α, normal offset and metalness."""
        return self.albedo, self.specular, self.alpha, self.normal_offset, self.metalness

    @classmethod
    def join(cls, parts: Sequence[PointBrdfs]) -> PointBrdfs:
        """Several in one."""
        return cls(*(torch.cat(values) for values in zip(*(part.all() for part in parts), strict=True)))


@dataclass(frozen=True)
class Priors:
    """Weights of the initial values, in units of a photograph with a frontal view, and settings of the robust fit."""

    albedo: float = 0.001
    specular: float = 0.02
    level: float = 0.01
    normal_offset: float = 0.01
    metalness: float = 0.02
    huber_srgb: float = 0.1
    """Residual in sRGB from which the loss is linear."""
    iterations: int = 20
    """More improve the result further (chair, held out: 22.62 dB with 12, 22.74 with 20, 22.79 with 40)."""

    @classmethod
    def of_albedo(cls) -> Priors:
        """Only the albedo changes; its equations are nearly linear."""
        return cls(specular=FROZEN_WEIGHT, level=FROZEN_WEIGHT, normal_offset=FROZEN_WEIGHT, iterations=6)

    @classmethod
    def of_base_color(cls) -> Priors:
        """Of `metallic` only the base colour changes, and both albedos with it."""
        return cls(metalness=FROZEN_WEIGHT, level=FROZEN_WEIGHT, normal_offset=FROZEN_WEIGHT, iterations=6)


@final
class FitArrays:
    """Points, photographs and probes of one take as Dr.Jit arrays: the constants of a fit.

    No dataclass: Dr.Jit would traverse it and make its arrays part of the state of loops.
    """

    def __init__(
        self,
        observed: ObservedPoints,
        model: Model,
        priors: Priors,
        dielectric_f0: float = DEFAULT_DIELECTRIC_F0,
    ) -> None:
        points, observations = observed.points, observed.observations
        tangent, bitangent = tangent_frame(points.normal)
        self.count = len(points.position)
        self.coupled = 0.0 if model == "paper" else 1.0
        """0 for `paper`; 1 for the other BRDFs, where the lobe reduces the diffuse part."""
        self.metallic = model == "metallic"
        self.priors = priors
        # opaque: a literal would compile a new kernel for each number of points or photographs
        self.dielectric_f0 = dr.opaque(mi.Float, dielectric_f0)
        self.points, self.views = dr.opaque(mi.UInt32, self.count), dr.opaque(mi.UInt32, len(observations.eyes))
        self.position, self.normal = vectors_of(points.position), vectors_of(points.normal)
        self.tangent, self.bitangent = vectors_of(tangent), vectors_of(bitangent)
        self.irradiance = vectors_of(points.irradiance)
        self.vectors = [vectors_of(points.vectors[:, :, channel]) for channel in range(3)]
        self.first = to_uint(points.cell, mi) * TEXELS_PER_PROBE
        """First texel of each point's probe."""
        self.probes = observed.probes.values
        self.color = linear_to_srgb(to_float(observations.color, mi))
        self.ceiling = linear_to_srgb(to_float(observations.ceiling, mi))
        """sRGB value from which each photograph is clipped."""
        self.weight, self.eyes = to_float(observations.weight, mi), to_float(observations.eyes, mi)
        dr.eval(self.color, self.ceiling)


def vectors_of(values: Float[Tensor, "P 3"]) -> DrJitArray:
    """A Vector3f of P rows."""
    return mi.Vector3f(*(to_float(values[:, axis], mi) for axis in range(3)))


def mean_of(color: DrJitArray) -> DrJitArray:
    """The mean of the channels of each point."""
    return (color.x + color.y + color.z) / 3  # dr.mean would average over the points too


@dataclass
class BrdfState:
    """The parameters of all points; a tree that Dr.Jit can traverse."""

    albedo: DrJitArray
    specular: DrJitArray
    level: DrJitArray
    """Level of α (`radiance_probes.level_of`)."""
    along: DrJitArray
    across: DrJitArray
    """Normal offset along tangent and bitangent: `along`, `across`."""
    metalness: DrJitArray


@dataclass
class NormalEquations:
    """The cost of a state and its normal equations.

    In the names, d is the albedo and f is ρs, by colour; a is the level of α; 1 and 2 are the components of the normal
    offset; e is the residual.
    """

    cost: DrJitArray
    """Robust squared residuals of all photographs of each point, and of the distance to its initial values."""
    colors: DrJitArray
    """dd, df, ff."""
    mixed: DrJitArray
    """da, d1, d2, fa, f1, f2."""
    shared: DrJitArray
    """aa, a1, a2, 11, 12, 22."""
    errors: DrJitArray
    """de, fe, by colour, and ae, 1e, 2e."""
