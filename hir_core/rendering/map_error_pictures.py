"""Pictures of how certain the maps of a run are: standard errors, and why blocks are uncertain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from hir_exporters.conventions import srgb_to_linear
from numpy.typing import NDArray

from hir_core.capture import Camera
from hir_core.metrics import Image, composite, unassociate
from hir_core.rendering.textured_scan import texture_as_material
from hir_core.rendering.unlit_renderer import UnlitRenderer
from hir_core.scene import Mesh, Scene
from hir_core.scene.map_errors import (
    IN_SHADOW,
    OBSERVED,
    OUTSIDE,
    UNDER_HIGHLIGHTS,
    UNDER_OBSERVED,
    MapErrors,
)

BRIGHTEST_ERROR = 0.2
"""Standard error that is shown white; for ρs a tenth of it."""
COLORS = {
    OUTSIDE: (0.0, 0.0, 0.0),
    OBSERVED: (0.45, 0.62, 0.47),
    UNDER_OBSERVED: (0.84, 0.33, 0.28),
    IN_SHADOW: (0.28, 0.40, 0.75),
    UNDER_HIGHLIGHTS: (0.93, 0.78, 0.33),
}
RAMP = np.array([(0.10, 0.12, 0.35), (0.15, 0.45, 0.62), (0.45, 0.72, 0.45), (0.95, 0.85, 0.35), (1.0, 1.0, 1.0)])
"""From an error of 0 to the brightest one."""
PREFIX = "error_"
CONDITION = "map_condition"


def map_error_pictures(errors: MapErrors, mesh: Mesh, cameras: Sequence[Camera]) -> dict[str, Image]:
    """By file name: each map, and the conditions of the blocks, on the object as the cameras see it, side by side."""
    maps: Mapping[str, NDArray[np.float32]] = {"base_color": errors.base_color.mean(axis=2)} | errors.maps
    shown = {PREFIX + name: _ramp(values, name) for name, values in maps.items()}
    shown[CONDITION] = np.array([COLORS[code] for code in range(len(COLORS))], np.float32)[errors.condition]
    return {
        name: _on_object(_beyond_charts(colors, errors.condition != OUTSIDE), mesh, cameras)
        for name, colors in shown.items()
    }


def _ramp(values: NDArray[np.float32], name: str) -> Image:
    brightest = BRIGHTEST_ERROR / 10 if name == "specular" else BRIGHTEST_ERROR
    share = np.clip(np.nan_to_num(values) / brightest, 0, 1)
    stops = np.linspace(0, 1, len(RAMP))
    return np.stack([np.interp(share, stops, RAMP[:, channel]) for channel in range(3)], axis=-1).astype(np.float32)


def _beyond_charts(colors: Image, surface: NDArray[np.bool_]) -> Image:
    """Blocks without surface get the colour of the nearest one with: lookups at the borders of charts read them."""
    from scipy.ndimage import distance_transform_edt

    rows, columns = distance_transform_edt(~surface, return_distances=False, return_indices=True)
    return np.asarray(colors[rows, columns])


def _on_object(colors: Image, mesh: Mesh, cameras: Sequence[Camera]) -> Image:
    """Pictures of equal height, from left to right."""
    texture = torch.from_numpy(srgb_to_linear(colors).astype(np.float32))
    renderer = UnlitRenderer(Scene(mesh, texture_as_material(texture)))
    views = [composite(*unassociate(renderer.render(camera))) for camera in cameras]
    height = min(len(view) for view in views)
    return np.concatenate([view[:height] for view in views], axis=1)
