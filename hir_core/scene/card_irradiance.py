"""What a light brings to the card of a capture, beside what the photographs of the card measured."""

from __future__ import annotations

import numpy as np
import torch
from hir_exporters.conventions import latlong_directions, latlong_solid_angles
from jaxtyping import Float
from torch import Tensor

from hir_core.capture import Array, Capture
from hir_core.scene.scene import EnvironmentMap


def card_irradiance(light: EnvironmentMap, capture: Capture) -> Float[Tensor, "N 3"]:
    """Irradiance on the card in each view that measured it, by the light alone.

    What the object hides of the light from the card, and what it reflects onto it, is left out. `capture.irradiance`
    must not be None.
    """
    assert capture.irradiance is not None
    normal = np.array(capture.irradiance.normal)
    normals: Array = np.repeat(normal[None], len(measuring_views(capture)), axis=0)
    if light.frame == "camera":
        normals = np.stack([capture.cameras[i].world_to_camera[:3, :3] @ normal for i in measuring_views(capture)])
    if light.to_world is not None:
        normals = normals @ light.to_world.detach().cpu().double().numpy()
    height, width, _ = light.radiance.shape
    # of a light in the world all rows are equal
    different, row = np.unique(normals, axis=0, return_inverse=True)
    cosine = np.maximum(different @ latlong_directions(height, width).reshape(-1, 3).T, 0)
    solid = np.broadcast_to(latlong_solid_angles(height, width), (height, width)).reshape(-1)
    kernel = torch.from_numpy((cosine * solid).astype(np.float32)).to(light.radiance)
    found = kernel @ light.radiance.reshape(-1, 3)
    return found[torch.from_numpy(row.reshape(-1)).to(found.device)]


def measured_over_found(light: EnvironmentMap, capture: Capture) -> Float[Tensor, " 3"]:
    """By which factor of each channel the light must change for the card: geometric mean over the views; 1 for a light
    that brings it nothing, and where no view of `capture` shows the card.
    """
    assert capture.irradiance is not None
    if not measuring_views(capture):
        return torch.ones(3).to(light.radiance)
    values = [capture.irradiance.values[capture.views[i].name] for i in measuring_views(capture)]
    found = card_irradiance(light, capture).double()
    ratio = torch.tensor(np.array(values)).to(found) / found.clamp_min(1e-12)
    ratio = torch.where(found > 0, ratio, torch.ones_like(ratio))
    return ratio.log().mean(dim=0).exp().to(light.radiance)


def measuring_views(capture: Capture) -> list[int]:
    """Views that show the card; empty without one."""
    if capture.irradiance is None:
        return []
    return [i for i, view in enumerate(capture.views) if view.name in capture.irradiance.values]
