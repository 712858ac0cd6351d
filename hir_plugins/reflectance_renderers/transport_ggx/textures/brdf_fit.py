"""Albedo, ρs, α and normal of single points by damped least squares, each from its photographs alone (Dr.Jit).

Under a known light a point's nine numbers depend on nothing but its own photographs, so all points are solved at once
(`point_steps.py`), with lobes that are looked up in probes (`lobe_lookup.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import torch
from jaxtyping import Float, Int
from torch import Tensor

from hir_plugins.reflectance_renderers.brdf_torch import Model
from hir_plugins.reflectance_renderers.drjit_arrays import to_color, to_float, to_torch, to_uint
from hir_plugins.reflectance_renderers.transport_ggx.operator.probe_lookup import (
    PROBE,
    ProbeTable,
    lobe_of,
    patch_around,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.radiance_probes import alpha_of, level_of
from hir_plugins.reflectance_renderers.transport_ggx.operator.specular_lobes import frame
from hir_plugins.reflectance_renderers.transport_ggx.textures.brdf_fit_steps import (
    LEAST_RHO,
    State,
    arriving_at,
    bent_normal,
    equations,
    radiance,
    srgb,
    step,
)
from hir_plugins.reflectance_renderers.transport_ggx.textures.observations import Sightings

HELD = 1e8
"""Weight of a start that nothing moves."""
FIRST_DAMPING = 0.01


@dataclass(frozen=True, eq=False)
class Points:
    """P points and the light at each."""

    position: Float[Tensor, "P 3"]
    normal: Float[Tensor, "P 3"]
    """Of the mesh; unit."""
    cell: Int[Tensor, " P"]
    """Whose probe they take."""
    irradiance: Float[Tensor, "P 3"]
    vectors: Float[Tensor, "P 3 3"]
    """Vector irradiance, axis by axis, then colours (`bending.py`)."""


@dataclass(frozen=True, eq=False)
class PointValues:
    """What is found for each point."""

    albedo: Float[Tensor, "P 3"]
    specular: Float[Tensor, "P 3"]
    alpha: Float[Tensor, "P 1"]
    tilt: Float[Tensor, "P 3"]
    """In the world (`bending.py`)."""

    def where(self, chosen: Tensor, other: PointValues) -> PointValues:
        """These where `chosen` (P,) says so, the others elsewhere."""
        pairs = zip(self.all(), other.all(), strict=True)
        return PointValues(*(torch.where(chosen[:, None], mine, others) for mine, others in pairs))

    def take(self, rows: Tensor) -> PointValues:
        """Those of some of the points."""
        return PointValues(*(value[rows] for value in self.all()))

    def all(self) -> tuple[Tensor, ...]:
        """Albedo, ρs, α and tilt."""
        return self.albedo, self.specular, self.alpha, self.tilt

    @classmethod
    def join(cls, parts: Sequence[PointValues]) -> PointValues:
        """One behind the other."""
        return cls(*(torch.cat(values) for values in zip(*(part.all() for part in parts), strict=True)))


@dataclass(frozen=True)
class Holds:
    """Weights of the start beside a photograph that sees a point straight on, and how far differences are trusted."""

    albedo: float = 0.001
    specular: float = 0.02
    level: float = 0.01
    tilt: float = 0.01
    """On normals that leave the mesh's."""
    huber: float = 0.1
    """In sRGB."""
    iterations: int = 20
    """More still gain (chair, held out: 12 end at 22.62 dB, 20 at 22.74, 40 at 22.79)."""

    @classmethod
    def of_albedo(cls) -> Holds:
        """Nothing but the albedo moves; its equations are nearly linear."""
        return cls(specular=HELD, level=HELD, tilt=HELD, iterations=6)


class PointFit:
    """Some points with their photographs, ready to be solved."""

    def __init__(self, points: Points, seen: Sightings, probes: ProbeTable, model: Model, holds: Holds) -> None:
        tangent, bitangent = frame(points.normal)
        self._axes = tangent, bitangent
        self._device = points.position.device
        self.count = len(points.position)
        self.coupled = 1.0 if model == "dielectric" else 0.0
        self.holds = holds
        self.points, self.views = dr.opaque(mi.UInt32, self.count), dr.opaque(mi.UInt32, len(seen.eyes))
        self.place, self.normal = _vector(points.position), _vector(points.normal)
        self.tangent, self.bitangent = _vector(tangent), _vector(bitangent)
        self.irradiance = _vector(points.irradiance)
        self.vectors = [_vector(points.vectors[:, :, channel]) for channel in range(3)]
        self.first = to_uint(points.cell, mi) * PROBE
        self.probes = probes.values
        self.color, self.ceiling = srgb(to_float(seen.color, mi)), srgb(to_float(seen.ceiling, mi))
        self.weight, self.eyes = to_float(seen.weight, mi), to_float(seen.eyes, mi)
        dr.eval(self.color, self.ceiling)

    def solve(self, start: PointValues) -> tuple[PointValues, Float[Tensor, " P"]]:
        """What explains each point's photographs best, near `start` where they leave it open, and its cost."""
        begun = state = self._state(start)
        # opaque: a number that a kernel knows makes it another kernel
        said, damping = equations(self, state, begun), dr.opaque(mi.Float, FIRST_DAMPING, self.count)
        dr.eval(said)
        for _ in range(self.holds.iterations):
            tried = step(self, state, said, damping)
            dr.eval(tried)
            found = equations(self, tried, begun)
            better = found.cost < said.cost  # also where either is NaN: the state stays
            state, said = dr.select(better, (tried, found), (state, said))
            damping = dr.select(better, dr.maximum(damping * 0.3, 1e-4), dr.minimum(damping * 6, 1e4))
            dr.eval(state, said, damping)
        return self._values(state), to_torch(said.cost, (self.count,), self._device)

    def shown(self, values: PointValues, toward: Float[Tensor, "P 3"]) -> Float[Tensor, "P 3"]:
        """Linear radiance of each point in a direction."""
        state, eye = self._state(values), _vector(toward)
        normal = bent_normal(self, state.along, state.across)
        lobe = lobe_of(normal, eye, state.level, self.coupled)
        patch = patch_around(self.probes, self.first, lobe)
        return to_color(radiance(self, state, patch, lobe, arriving_at(self, normal)), self._device)

    def _state(self, values: PointValues) -> State:
        tangent, bitangent = self._axes
        state = State(
            _vector(values.albedo.clamp(0, 1)),
            _vector(values.specular.clamp(LEAST_RHO, 1)),
            to_float(level_of(values.alpha), mi),
            to_float((values.tilt * tangent).sum(dim=1), mi),
            to_float((values.tilt * bitangent).sum(dim=1), mi),
        )
        dr.eval(state)
        return state

    def _values(self, state: State) -> PointValues:
        tangent, bitangent = self._axes
        along, across, level = (
            to_torch(value, (-1, 1), self._device) for value in (state.along, state.across, state.level)
        )
        albedo, specular = to_color(state.albedo, self._device), to_color(state.specular, self._device)
        return PointValues(albedo, specular, alpha_of(level), along * tangent + across * bitangent)


def _vector(values: Float[Tensor, "P 3"]) -> Any:
    return mi.Vector3f(*(to_float(values[:, axis], mi) for axis in range(3)))
