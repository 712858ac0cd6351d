"""Makes photographs equally exposed: the colour of a surface is predicted from other photographs than its own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hir_core.capture.relative_exposures import corrections_of_takes
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.scene import Mesh
from hir_core.scene.srgb import srgb_to_linear
from hir_core.stages.geometry.occlusion_boundaries.predicted_colors import observed_colors
from hir_core.stages.geometry.occlusion_boundaries.view_photographs import ViewPhotographs

POINTS = 4_000
"""Vertices at which photographs are compared."""
CLIPPED_SRGB = 0.98
"""A larger value may be clipped and says nothing about the exposure."""


def equally_exposed(
    photographs: ViewPhotographs, mesh: Mesh, tracer: MeshQueries, takes: Sequence[int]
) -> ViewPhotographs:
    """The photographs with one exposure and white balance for each take; as they are where these are equal."""
    step = max(1, len(mesh.positions) // POINTS)
    positions, normals = mesh.positions.detach()[::step], mesh.normals.detach()[::step]
    color = np.zeros((len(takes), len(positions), 3))
    known = np.zeros(color.shape, bool)
    for view in range(len(takes)):
        seen, weight = observed_colors(positions, normals, photographs, view, tracer)
        color[view] = srgb_to_linear(seen).cpu().numpy()
        known[view] = ((weight[:, None] > 0) & (seen < CLIPPED_SRGB)).cpu().numpy()
    toward = (photographs.centers - positions.double().mean(dim=0)).cpu().numpy()
    factors = corrections_of_takes(color, known, toward, takes)
    return photographs if factors is None else photographs.multiplied(factors)
