"""Differentiable radiance through the pixels of a capture, on cached transport."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import torch
from jaxtyping import Float, Int
from torch import Tensor

from hir_core.capture import Capture
from hir_core.plugins.interfaces import PreparedReflectance
from hir_core.scene import EnvironmentMap, Material
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.operator.take_lights import ONE_LIGHT
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.textures.texture_shading import Indirect, shade


@final
@dataclass(frozen=True, eq=False)
class TransportShading(PreparedReflectance):
    """One scene's geometry and one capture's cameras; indirect light as a fit has it, or none."""

    transport: Transport
    capture: Capture
    downsample: int
    options: TransportGGXOptions
    indirect: Sequence[Indirect] = ()
    """Of the light of each take; empty for none."""

    @cached_property
    def _of_one_light(self) -> Transport:
        return self.transport if self.transport.takes.count == 1 else replace(self.transport, takes=ONE_LIGHT)

    def radiance(
        self, material: Material, environment: EnvironmentMap, pixels: Int[Tensor, "B 3"]
    ) -> Float[Tensor, "B 3"]:
        """Radiance through pixels (view, x, y); 0 where they miss. Differentiable in material and light.

        All pixels have the light `environment`; indirect light is that of each pixel's take.
        """
        cameras = {v: c.downsampled(self.downsample) for v, c in enumerate(self.capture.cameras)}
        transport = self._of_one_light

        def of(part: Tensor, indirect: Indirect | None) -> Tensor:
            return shade(transport, material, environment, cameras, part, self.options, indirect)

        of_view = self.transport.takes.of_view
        if of_view is None or not self.indirect:
            return of(pixels, self.indirect[0] if self.indirect else None)
        takes = of_view[pixels[:, 0]]
        rows = [(takes == take).nonzero()[:, 0] for take in range(len(self.indirect))]
        found = [of(pixels[part], indirect) for part, indirect in zip(rows, self.indirect, strict=True)]
        return torch.cat(found)[torch.cat(rows).argsort()]
