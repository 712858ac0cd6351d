"""Points with BRDFs of their own, shaded by lobes with visibility, as pixels of textures are."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import MIN_ALPHA
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.specular_lobes import Lobes
from hir_plugins.reflectance_renderers.transport_ggx.operator.shading_normals import offset_normals
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import SurfacePoints
from hir_plugins.reflectance_renderers.transport_ggx.textures.brdf_fit_state import PointBrdfs
from hir_plugins.reflectance_renderers.transport_ggx.textures.per_texel_brdf import LitSurface
from hir_plugins.reflectance_renderers.transport_ggx.textures.texture_shading import (
    gain_and_lobe,
    irradiance_at,
    lobe_radiance,
)


@dataclass(frozen=True, eq=False)
class ShadedPoints:
    """What P points reflect towards their cameras."""

    gain: Float[Tensor, "P 3"]
    """Radiance of a diffuse albedo of 1."""
    lobe: Float[Tensor, "P 3"]
    """Specular radiance."""
    arriving: Float[Tensor, "P 3"]
    """Irradiance for the shading normal."""
    alpha: Float[Tensor, "P 1"]
    lobes: Lobes
    received: tuple[Float[Tensor, "P 3"], Float[Tensor, "P 3"]]
    """As `lobe_radiance` returns it."""

    @classmethod
    def of(cls, lit: LitSurface, points: SurfacePoints, values: PointBrdfs, directions: int, seed: int) -> ShadedPoints:
        """Points with the normals of the mesh, and their BRDFs; a lobe of `directions` takes some 100 bytes each."""
        transport, alpha = lit.transport, values.alpha.clamp(MIN_ALPHA, 1)
        turned = points.with_normals(offset_normals(points.normal, values.normal_offset))
        arriving = irradiance_at(transport, turned, points.normal, lit.irradiance, lit.vectors)
        lobes = transport.lobes(turned, alpha, directions, None, seed)
        received = lobe_radiance(lobes, alpha, lit.sources)
        gain, lobe = gain_and_lobe(lit.model, values.specular, alpha, arriving, lobes, received)
        return cls(gain, lobe, arriving, alpha, lobes, received)
