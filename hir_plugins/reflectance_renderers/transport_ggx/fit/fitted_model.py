"""The result of a fit: a model and its parameters."""

from __future__ import annotations

from dataclasses import dataclass

from hir_core.plugins.model_spec import ModelSpec
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters


@dataclass(frozen=True, eq=False)
class Fit:
    """The fitted parameters of a model."""

    spec: ModelSpec
    parameters: Parameters
    views: tuple[int, ...] = ()
    """Views that it was fitted to; per-texel values are solved from them."""

    @property
    def scene_parameters(self) -> Parameters:
        """The parameters of its scene: the albedo in closed form."""
        return self.parameters.with_closed_form_albedo
