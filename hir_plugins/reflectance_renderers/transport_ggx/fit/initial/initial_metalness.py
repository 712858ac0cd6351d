"""Initial values of the `metallic` BRDF from fits of other models, and of other models from a `metallic` fit."""

from __future__ import annotations

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from hir_plugins.reflectance_renderers.transport_ggx.fit.final_albedo import ALBEDO_HIGH, ALBEDO_LOW
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters

UNDECIDED_METALNESS = 0.5
EVIDENCE_WEIGHT = 0.5
"""Share of an earlier fit's metalness in the initial one; the rest is `UNDECIDED_METALNESS`. At 0 or 1 the logistic
function has no slope."""


def with_metalness(base: Parameters, f0: Float[Tensor, "1 1"], everywhere: bool) -> Parameters:
    """Parameters of the `metallic` BRDF: m is 1 `everywhere`, or for each vertex, near what the earlier fit says.

    `f0` is the logit of F0 where `base` has none of its own.
    """
    count = len(base.diffuse)
    if base.metalness is None:
        color, metalness = metallic_of(base, torch.sigmoid(f0))
        diffuse = torch.logit(color.clamp(ALBEDO_LOW, ALBEDO_HIGH))
    else:
        assert base.specular is not None, "a metallic fit has an F0"
        diffuse, metalness, f0 = base.diffuse, base.metal_share.expand(count, 1), base.specular
    if everywhere:
        logits = torch.full_like(f0, torch.inf)
    elif base.metalness is None or base.is_metal:
        logits = torch.logit(UNDECIDED_METALNESS + EVIDENCE_WEIGHT * (metalness - UNDECIDED_METALNESS))
    else:
        logits = base.metalness.expand(count, 1)
    return replace(base, diffuse=diffuse.contiguous(), specular=f0, metalness=logits.contiguous())


def without_metalness(base: Parameters) -> Parameters:
    """Parameters of the other BRDFs, with ρd and the mean ρs of a `metallic` fit."""
    if base.metalness is None:
        return base
    specular = base.specular_albedo.mean(dim=0, keepdim=True).mean(dim=1, keepdim=True)
    diffuse, specular = (torch.logit(a.clamp(ALBEDO_LOW, ALBEDO_HIGH)) for a in (base.diffuse_albedo, specular))
    return replace(base, diffuse=diffuse, specular=specular, metalness=None, closed_form_diffuse=None)


def metallic_of(base: Parameters, f0: Float[Tensor, "1 1"]) -> tuple[Float[Tensor, "V 3"], Float[Tensor, "V 1"]]:
    """Base colour and metalness whose albedos are nearest to those of a fit without metalness.

    With u = 1 − m, and sums over the colours D = Σρd and S = Σρs: D = u·B and S = u·3F0 + (1 − u)·B give
    3F0·u² − (D + S)·u + D = 0. Both are exact where a base colour and a metalness exist.
    """
    diffuse = base.diffuse_albedo
    if base.specular is None:
        return diffuse, torch.full_like(diffuse[:, :1], UNDECIDED_METALNESS)
    specular = base.specular_albedo.expand(len(diffuse), 3)
    return metallic_of_albedos(diffuse, specular, f0)


def metallic_of_albedos(
    diffuse: Float[Tensor, "N 3"], specular: Float[Tensor, "N 3"], f0: Float[Tensor, "1 1"]
) -> tuple[Float[Tensor, "N 3"], Float[Tensor, "N 1"]]:
    """`metallic_of` for albedos; the base colour is clamped to 0…1."""
    total, rest = diffuse.sum(dim=1, keepdim=True), (diffuse + specular).sum(dim=1, keepdim=True)
    root = (rest.square() - 12 * f0 * total).clamp_min(0).sqrt()
    share = (2 * total / (rest + root).clamp_min(1e-9)).clamp(0, 1)
    return (diffuse + specular - share * f0).clamp(0, 1), 1 - share
