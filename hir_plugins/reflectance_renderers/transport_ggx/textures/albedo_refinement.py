"""The last albedo, under what path tracing shows: cells, split sums and few directions leave no trace in it.

A path tracer is exact but slow and noisy. So it is asked once, for the pixels that the textures were solved from; how
a pixel changes with its albedo is taken from the cache, and the noise enters where the photographs' does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from hir_core.plugins.interfaces import PreparedReflectance
from hir_core.scene import Scene
from hir_core.stages.atlas import dilate, fill_unobserved, texel_surface
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import Surface
from hir_plugins.reflectance_renderers.transport_ggx.textures.texel_equations import TexelEquations, solve_texels
from hir_plugins.reflectance_renderers.transport_ggx.textures.texture_solve import (
    HUBER_SRGB,
    PADDING,
    PRIOR,
    SMOOTH,
    refined_mesh,
)


@dataclass(eq=False)
class AlbedoRefinement:
    """A scene and the equations that its albedo was solved from, view by view."""

    scene: Scene
    equations: list[TexelEquations]
    _shown: dict[int, Tensor] = field(default_factory=dict)

    def solved(
        self,
        surface: Surface,
        traced: PreparedReflectance | None,
        views: Sequence[int],
        report: Callable[[float], None],
    ) -> Scene | None:
        """With the albedo that pixels of `views` ask for, under what `traced` shows; None if there are none."""
        material, allowed = self.scene.material, set(views)
        parts = [e for e in self.equations if len(e.pixel) and int(e.pixel[0, 0]) in allowed]
        if material is None or material.diffuse_albedo.ndim != 3 or material.observed is None or not parts:
            return None
        albedo = material.diffuse_albedo
        with torch.no_grad():
            rows = []
            for done, part in enumerate(parts):
                rows.append(part if traced is None else self._corrected(part, traced, albedo))
                report(0.9 * (done + 1) / len(parts))
            found, _ = solve_texels(rows, albedo, HUBER_SRGB, PRIOR, SMOOTH)
            mesh = refined_mesh(surface)
            texels = texel_surface(mesh, (albedo.shape[0], albedo.shape[1]))
            filled = fill_unobserved(found, mesh, material.observed, texels)
            albedo = dilate(filled, texels.covered, PADDING)
        report(1.0)
        return replace(self.scene, material=replace(material, diffuse_albedo=albedo))

    def _corrected(self, rows: TexelEquations, traced: PreparedReflectance, albedo: Tensor) -> TexelEquations:
        """The same rows; what pixels show besides their albedo is what is left of the traced radiance."""
        view = int(rows.pixel[0, 0])
        if view not in self._shown:
            assert self.scene.material is not None and self.scene.environment is not None
            torch.manual_seed(view)
            shown = traced.radiance(self.scene.material, self.scene.environment, rows.pixel)
            # one broken pixel would reach every texel through conjugate gradients; this one asks for no change
            self._shown[view] = torch.where(torch.isfinite(shown), shown, rows.color)
        looked_up = (albedo.reshape(-1, 3)[rows.index] * rows.weight[..., None]).sum(dim=1)
        return replace(rows, rest=self._shown[view] - rows.gain * looked_up)
