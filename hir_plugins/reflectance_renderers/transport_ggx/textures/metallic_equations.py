"""The equations of a base colour texture of the `metallic` BRDF, to first order around a given one."""

from __future__ import annotations

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from hir_plugins.reflectance_renderers.brdf_torch import directional_albedo_terms
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.specular_lobes import Lobes
from hir_plugins.reflectance_renderers.transport_ggx.textures.texel_equations import TexelEquations


def metallic_equations(
    rows: TexelEquations,
    base: Float[Tensor, "H W 3"],
    metalness: Float[Tensor, "H W 1"],
    f0: float,
    arriving: Float[Tensor, "P 3"],
    lobes: Lobes,
    alpha: Float[Tensor, "#P 1"],
    received: tuple[Float[Tensor, "P 3"], Float[Tensor, "P 3"]],
) -> TexelEquations:
    """`rows` with the gains and the offset of a base colour; `received` as `texture_shading.lobe_radiance` returns it.

    With g = irradiance / π, E = a·ρs + b and the lobe ρs·(W − G) + G the radiance is (1 − E)·g·ρd + ρs·(W − G) + G,
    ρd = (1 − m)·base and ρs = (1 − m)·F0 + m·base. So the base colour acts in ρd with (1 − E)·g, and in ρs with
    W − G − a·g·ρd. Where m is 0 or 1 the equations are exact.
    """

    def at(texels: Float[Tensor, "H W C"]) -> Float[Tensor, "P C"]:
        return (texels.reshape(-1, texels.shape[2])[rows.index] * rows.weight[..., None]).sum(dim=1)

    diffuse, specular = at((1 - metalness) * base), at((1 - metalness) * f0 + metalness * base)
    light, (white, grazing) = arriving / torch.pi, received
    a, b = directional_albedo_terms(lobes.n_wo[:, None], alpha)
    gain = light * (1 - specular * a - b).clamp_min(0)
    metal_gain = white - grazing - a * light * diffuse
    whole = diffuse * gain + specular * (white - grazing) + grazing
    solved = replace(rows, gain=gain, metal_gain=metal_gain)
    return replace(solved, offset=whole - solved.radiance(base, metalness))
