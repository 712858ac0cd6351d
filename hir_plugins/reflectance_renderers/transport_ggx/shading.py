"""Differentiable radiance through the pixels of a capture, on cached transport."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from jaxtyping import Float, Int
from torch import Tensor

from hir_core.capture import Capture
from hir_core.plugins.interfaces import PreparedReflectance
from hir_core.scene import EnvironmentMap, Material
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
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
    indirect: Indirect | None = None

    def radiance(
        self, material: Material, environment: EnvironmentMap, pixels: Int[Tensor, "B 3"]
    ) -> Float[Tensor, "B 3"]:
        """Radiance through pixels (view, x, y); 0 where they miss. Differentiable in material and light."""
        cameras = {v: c.downsampled(self.downsample) for v, c in enumerate(self.capture.cameras)}
        return shade(self.transport, material, environment, cameras, pixels, self.options, self.indirect)
