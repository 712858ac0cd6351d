"""Albedo, ρs, α and normal of single points by damped least squares, each from its own photographs (Dr.Jit).

For a known light the nine parameters of a point depend only on its own photographs. So all points are solved at once
(`brdf_fit_steps.py`), with lobes that are looked up in radiance probes (`operator/probe_lookup.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import drjit as dr
import mitsuba as mi
import torch
from hir_exporters.metallic_parameters import DEFAULT_DIELECTRIC_F0
from jaxtyping import Float, Int
from torch import Tensor

from hir_plugins.reflectance_renderers.brdf_torch import Model
from hir_plugins.reflectance_renderers.drjit_arrays import to_color, to_float, to_torch
from hir_plugins.reflectance_renderers.transport_ggx.operator.probe_lookup import lobe_of, patch_around
from hir_plugins.reflectance_renderers.transport_ggx.operator.radiance_probes import alpha_of, level_of
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import tangent_frame
from hir_plugins.reflectance_renderers.transport_ggx.textures.brdf_fit_state import (
    MIN_SPECULAR_ALBEDO,
    BrdfState,
    FitArrays,
    ObservedPoints,
    PointBrdfs,
    Priors,
    mean_of,
    vectors_of,
)
from hir_plugins.reflectance_renderers.transport_ggx.textures.brdf_fit_steps import (
    arriving_radiance,
    normal_equations,
    radiance,
    shading_normal,
    step,
)
from hir_plugins.reflectance_renderers.transport_ggx.textures.metallic_steps import metallic_step

INITIAL_DAMPING, MIN_DAMPING, MAX_DAMPING = 0.01, 1e-4, 1e4
DAMPING_DECREASE, DAMPING_INCREASE = 0.3, 6
"""Factors after a step that lowered the cost, and after one that did not."""


@final
class PointBrdfFit:
    """Points with their photographs, ready to be solved."""

    def __init__(
        self,
        takes: Sequence[ObservedPoints],
        model: Model,
        priors: Priors,
        dielectric_f0: float = DEFAULT_DIELECTRIC_F0,
    ) -> None:
        """`takes`: the same points under the light of each take; at least one."""
        self.takes = [FitArrays(observed, model, priors, dielectric_f0) for observed in takes]
        self._frame = tangent_frame(takes[0].points.normal)
        self._device = takes[0].points.position.device

    def solve(self, start: PointBrdfs) -> tuple[PointBrdfs, Float[Tensor, " P"]]:
        """The BRDFs that fit the photographs of each point best, near `start` where they are ambiguous; the cost."""
        arrays = self.takes[0]
        initial = state = self.state(start)
        # opaque: a literal would compile another kernel
        current, damping = (
            normal_equations(self.takes, state, initial),
            dr.opaque(mi.Float, INITIAL_DAMPING, arrays.count),
        )
        dr.eval(current)
        for _ in range(arrays.priors.iterations):
            if arrays.metallic:
                trial = metallic_step(arrays, state, initial, current, damping)
            else:
                trial = step(arrays, state, current, damping)
            dr.eval(trial)
            candidate = normal_equations(self.takes, trial, initial)
            better = candidate.cost < current.cost  # false if either is NaN: the state stays
            state, current = dr.select(better, (trial, candidate), (state, current))
            damping = dr.select(
                better,
                dr.maximum(damping * DAMPING_DECREASE, MIN_DAMPING),
                dr.minimum(damping * DAMPING_INCREASE, MAX_DAMPING),
            )
            dr.eval(state, current, damping)
        return self._values(state), to_torch(current.cost, (arrays.count,), self._device)

    def predict(
        self, values: PointBrdfs, toward: Float[Tensor, "P 3"], take: Int[Tensor, " P"] | None = None
    ) -> Float[Tensor, "P 3"]:
        """Linear radiance of each point in a direction, under the light of its take, without `take` of the first."""
        found = self._predict(self.takes[0], values, toward)
        for number, arrays in enumerate(self.takes[1:], 1):
            if take is not None and bool((take == number).any()):
                found = torch.where((take == number)[:, None], self._predict(arrays, values, toward), found)
        return found

    def _predict(self, arrays: FitArrays, values: PointBrdfs, toward: Float[Tensor, "P 3"]) -> Float[Tensor, "P 3"]:
        state, eye = self.state(values), vectors_of(toward)
        normal = shading_normal(arrays, state.along, state.across)
        lobe = lobe_of(normal, eye, state.level, mean_of(state.specular), arrays.coupled)
        patch = patch_around(arrays.probes, arrays.first, lobe)
        return to_color(radiance(arrays, state, patch, lobe, arriving_radiance(arrays, normal)), self._device)

    def state(self, values: PointBrdfs) -> BrdfState:
        """The BRDFs as Dr.Jit arrays."""
        tangent, bitangent = self._frame
        # the albedos of `metallic` follow from its base colour and must stay consistent
        least = 0.0 if self.takes[0].metallic else MIN_SPECULAR_ALBEDO
        state = BrdfState(
            vectors_of(values.albedo.clamp(0, 1)),
            vectors_of(values.specular.clamp(least, 1)),
            to_float(level_of(values.alpha), mi),
            to_float((values.normal_offset * tangent).sum(dim=1), mi),
            to_float((values.normal_offset * bitangent).sum(dim=1), mi),
            to_float(values.metalness[:, 0], mi),
        )
        dr.eval(state)
        return state

    def _values(self, state: BrdfState) -> PointBrdfs:
        tangent, bitangent = self._frame
        along, across, level, metalness = (
            to_torch(value, (-1, 1), self._device)
            for value in (state.along, state.across, state.level, state.metalness)
        )
        albedo, specular = to_color(state.albedo, self._device), to_color(state.specular, self._device)
        return PointBrdfs(albedo, specular, alpha_of(level), along * tangent + across * bitangent, metalness)
