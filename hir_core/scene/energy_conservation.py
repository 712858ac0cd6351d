"""Energy conservation: a surface reflects no more light than it receives. The excess is taken from the diffuse part."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from hir_core.scene.scene import Material

CHANGE_TOLERANCE = 1e-6
"""Smaller changes of an albedo are rounding errors."""


def with_conserved_energy(material: Material) -> tuple[Material, float]:
    """The material with albedos in 0…1 and, in the `paper` model, ρd + ρs ≤ 1; and the share of changed diffuse values.

    `dielectric` couples its diffuse part to the lobe, so that each albedo ≤ 1 is enough; in `metallic`, base colour and
    metalness ≤ 1. NaN and −∞ become 0, ∞ 1.
    """
    if material.metalness is not None:
        return _conserved_metallic(material)
    specular = _clamped(material.specular_albedo)
    diffuse = _clamped(material.diffuse_albedo)
    if material.model == "paper":
        diffuse = torch.minimum(*torch.broadcast_tensors(diffuse, 1 - specular_at_size_of(specular, diffuse)))
    conserved = replace(material, diffuse_albedo=diffuse, specular_albedo=specular)
    return conserved, _changed_share(material.diffuse_albedo, diffuse)


def _conserved_metallic(material: Material) -> tuple[Material, float]:
    assert material.metalness is not None
    conserved = Material.metallic(
        _clamped(material.base_color),
        _clamped(material.metalness),
        material.roughness,
        material.normal,
        material.observed,
        material.dielectric_f0,
    )
    return conserved, _changed_share(material.diffuse_albedo, conserved.diffuse_albedo)


def _changed_share(before: Tensor, after: Tensor) -> float:
    changed = (after - before).abs() > CHANGE_TOLERANCE
    return float((changed | ~torch.isfinite(before)).float().mean())


def _clamped(albedo: Tensor) -> Tensor:
    return torch.nan_to_num(albedo, nan=0.0, posinf=1.0, neginf=0.0).clamp(0, 1)


def specular_at_size_of(specular: Tensor, diffuse: Tensor) -> Tensor:
    """The specular albedo resampled to the height and width of the diffuse texture.

    Each is a texture (H, W, C) or a constant (C,). Next to a constant diffuse albedo a texture becomes its maximum.
    """
    if specular.ndim != 3 or diffuse.ndim != 3 or specular.shape[:2] == diffuse.shape[:2]:
        return specular if specular.ndim != 3 or diffuse.ndim == 3 else specular.amax(dim=(0, 1))
    planes = specular.movedim(2, 0)[None]
    scaled = torch.nn.functional.interpolate(planes, diffuse.shape[:2], mode="bilinear", align_corners=False)
    return scaled[0].movedim(0, 2)
