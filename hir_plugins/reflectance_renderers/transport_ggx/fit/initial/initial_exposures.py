"""First exposures of photographs, before light and material are known; the fit improves them."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from hir_core.capture.relative_exposures import relative_exposures
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.observed_pixels import ObservedPixels
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import Surface


def initial_exposures(
    surface: Surface, observed: ObservedPixels, eyes: NDArray[np.float64]
) -> Float[Tensor, "views 3"]:
    """Logarithms of brightness and white balance of each view, with a mean of 0; 0 for a view without pixels.

    `eyes`: the centre of each view's camera, (views, 3).
    """
    nearest = observed.points.barycentric.argmax(dim=1, keepdim=True)
    found = relative_exposures(
        observed.color.double().cpu().numpy(),
        ~observed.saturated.cpu().numpy(),
        surface.faces[observed.points.face].gather(1, nearest)[:, 0].cpu().numpy(),
        observed.points.view.cpu().numpy(),
        eyes - surface.positions.double().cpu().numpy().mean(axis=0),
    )
    return torch.from_numpy(found).to(observed.color)
