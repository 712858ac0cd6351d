"""A surface gives back no more light than it gets: what a fit leaves above that is taken from the diffuse part."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from hir_core.scene.scene import Material


def conserving(material: Material) -> tuple[Material, float]:
    """The material with albedos in 0…1 and, in the `paper` model, ρd + ρs ≤ 1; and the share of values that changed.

    `dielectric` couples its diffuse part to the lobe, so that each albedo ≤ 1 is enough. What is not finite becomes 0.
    """
    specular = _unit(material.specular_albedo)
    diffuse = _unit(material.diffuse_albedo)
    if material.model == "paper":
        diffuse = torch.minimum(*torch.broadcast_tensors(diffuse, 1 - specular_like(specular, diffuse)))
    changed = (diffuse - material.diffuse_albedo).abs() > 1e-6
    guarded = replace(material, diffuse_albedo=diffuse, specular_albedo=specular)
    return guarded, float((changed | ~torch.isfinite(material.diffuse_albedo)).float().mean())


def _unit(albedo: Tensor) -> Tensor:
    return torch.nan_to_num(albedo, nan=0.0, posinf=1.0, neginf=0.0).clamp(0, 1)


def specular_like(specular: Tensor, diffuse: Tensor) -> Tensor:
    """A specular map at the size of the diffuse one."""
    if specular.ndim != 3 or diffuse.ndim != 3 or specular.shape[:2] == diffuse.shape[:2]:
        return specular if specular.ndim != 3 or diffuse.ndim == 3 else specular.amax(dim=(0, 1))
    planes = specular.movedim(2, 0)[None]
    scaled = torch.nn.functional.interpolate(planes, diffuse.shape[:2], mode="bilinear", align_corners=False)
    return scaled[0].movedim(0, 2)
