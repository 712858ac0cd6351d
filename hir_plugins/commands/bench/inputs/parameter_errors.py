"""Errors of a fitted material in the views of a capture whose material is known at every pixel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import torch
from hir_exporters.conventions import linear_to_srgb, srgb_to_linear
from hir_exporters.textures.image_files import read_ldr
from numpy.typing import NDArray

from hir_core.capture import Capture
from hir_core.metrics import OBJECT_COVERAGE, ChannelScale, mean, psnr, unassociate
from hir_core.rendering.unlit_renderer import UnlitRenderer
from hir_core.scene import Material, Scene

Array = NDArray[np.float32]

METAL: Final = 0.5
"""A pixel with at least this metalness counts as metal."""
WHOLE: Final = 0.95
"""An object is a metal, or has none, where this share of its pixels agrees; else it is mixed. Texels at the outline and
in gaps that no view sees are unreliable."""


@dataclass(frozen=True)
class ParameterErrors:
    """Of a fitted material, over the object's pixels of all views."""

    errors: Mapping[str, float]
    """Base colour as PSNR in sRGB, unscaled and with one factor per channel; metalness and roughness as mean absolute
    difference. Roughness is missing where the fit has no specular lobe."""
    metal_share: float
    """Share of the pixels that are metal in the fit."""

    def kind(self, material: Material) -> str:
        """`diffuse`, `dielectric`, `metal` or `mixed`."""
        if material.metalness is None or self.metal_share <= 1 - WHOLE:
            return "dielectric" if _has_lobe(material) else "diffuse"
        return "metal" if self.metal_share >= WHOLE else "mixed"


def parameter_errors(scene: Scene, capture: Capture, truth: Path) -> ParameterErrors:
    """Compares base colour, metalness and roughness of `scene` with the pictures in `truth`, view by view.

    The base colour of a model without metalness is its diffuse albedo. Roughness is √α (glTF).
    """
    material = scene.material
    assert material is not None
    fits = {name: UnlitRenderer(scene_showing(values, scene)) for name, values in _parameters(material).items()}
    scale, colors = ChannelScale(), []
    differences: dict[str, list[Array]] = {name: [] for name in fits if name != "base_color"}
    metal = []
    for view, camera in zip(capture.views, capture.cameras, strict=True):
        rendered = {name: unassociate(renderer.render(camera)) for name, renderer in fits.items()}
        for name, (values, coverage) in rendered.items():
            picture = read_ldr(truth / f"{Path(view.name).stem}_{name}.png")
            inside = (picture[..., 3] > OBJECT_COVERAGE) & (coverage > OBJECT_COVERAGE)
            fit, true = values[inside], picture[..., :3][inside]
            if name == "base_color":
                colors.append((fit, srgb_to_linear(true).astype(np.float32)))
                scale.add(*colors[-1])
            else:
                differences[name].append(np.abs(fit - true)[:, 0])
            if name == "metallic":
                metal.append(fit[:, 0] >= METAL)
    factor = scale.value.astype(np.float32)
    errors = {
        "base colour dB": mean([psnr(_srgb(fit), _srgb(true)) for fit, true in colors]) or 0.0,
        "base colour scaled dB": mean([psnr(_srgb(fit * factor), _srgb(true)) for fit, true in colors]) or 0.0,
        "metalness error": float(np.concatenate(differences["metallic"]).mean()),
    }
    if "roughness" in differences:
        errors["roughness error"] = float(np.concatenate(differences["roughness"]).mean())
    return ParameterErrors(errors, float(np.concatenate(metal).mean()))


def _parameters(material: Material) -> dict[str, torch.Tensor]:
    """Base colour, metalness and roughness, each a texture or a constant, by the names of the true pictures."""
    if material.metalness is None:
        base, metalness = material.diffuse_albedo, torch.zeros(1)
    else:
        base, metalness = material.base_color, material.metalness
    found = {"base_color": base, "metallic": metalness}
    return found | {"roughness": material.roughness.sqrt()} if _has_lobe(material) else found


def _has_lobe(material: Material) -> bool:
    return bool((material.specular_albedo > 0).any())


def scene_showing(values: torch.Tensor, scene: Scene) -> Scene:
    """The mesh of a scene with `values`, a texture or a constant of one or three channels, for its diffuse albedo."""
    values = values.detach().expand(*values.shape[:-1], 3)
    return replace(scene, material=Material("paper", values, torch.zeros(3), torch.ones(1)))


def _srgb(linear: Array) -> Array:
    return np.asarray(linear_to_srgb(np.clip(linear, 0, 1)), dtype=np.float32)
