"""Radiance through the pixels of several takes, each under its own light."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from hir_core.capture import Capture
from hir_core.plugins.interfaces import PreparedReflectance
from hir_core.scene import Material, Scene


def radiance_in_takes(
    prepared: PreparedReflectance,
    scene: Scene,
    capture: Capture,
    pixels: Int[Tensor, "B 3"],
    material: Material | None = None,
) -> Float[Tensor, "B 3"]:
    """Radiance through pixels (view, x, y) of `capture`, under the light of each view's take.

    `material` replaces that of the scene. Raises `InputError` for a take whose light the scene lacks. The noise of a
    stochastic renderer follows torch's random generator, take by take.
    """
    material = material or scene.material
    assert material is not None and scene.environment is not None
    if not scene.take_radiance:
        return prepared.radiance(material, scene.environment, pixels)
    numbers = torch.tensor(capture.take_numbers, device=pixels.device)[pixels[:, 0]]
    found = torch.zeros(len(pixels), 3, device=scene.environment.radiance.device)
    for number, name in enumerate(capture.takes):
        rows = (numbers == number).nonzero()[:, 0]
        if len(rows):
            light = scene.in_take(name).environment
            assert light is not None
            radiance = prepared.radiance(material, light, pixels[rows])
            found = found.to(radiance.dtype).index_copy(0, rows.to(found.device), radiance)
    return found
