"""Radiance probes: each is the light through a lobe, computed by spectra along rows, and by direct sums here."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from hir_core.testing.scenes import two_spheres
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import build_transport
from hir_plugins.reflectance_renderers.transport_ggx.operator.radiance_probes import (
    ALPHA_LEVELS,
    PROBE_COLUMNS,
    PROBE_ROWS,
    alpha_of,
    build_probes,
)


def directions(rows: int, columns: int) -> NDArray[np.float64]:
    """(rows, columns, 3): of texel centres, as docs/conventions.md says."""
    theta = (np.arange(rows) + 0.5) / rows * np.pi
    phi = (0.5 - (np.arange(columns) + 0.5) / columns) * 2 * np.pi
    theta, phi = np.meshgrid(theta, phi, indexing="ij")
    return np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)], axis=-1)


def lobe(normal: NDArray[np.float64], alpha: float, toward: NDArray[np.float64]) -> NDArray[np.float64]:
    """GGX distribution × Smith masking × cosine of a view along the normal, without constants (R, W)."""
    cosine = toward @ normal
    lit = cosine > 0
    cosine = np.where(lit, cosine, 1.0)
    n_h = np.cos(np.arccos(np.clip(cosine, -1, 1)) / 2)
    distribution = 1 / (n_h**2 * (alpha**2 - 1) + 1) ** 2
    tangent = np.sqrt(1 - cosine**2) / cosine
    masking = 2 / (1 + np.sqrt(1 + (alpha * tangent) ** 2))
    return np.where(lit, distribution * masking, 0.0)


@pytest.mark.parametrize(("height", "width", "sun"), [(16, 32, 40.0), (12, 20, 40.0), (8, 45, 40.0), (16, 32, 1e5)])
def test_probes_are_direct_sums_over_the_light(height: int, width: int, sun: float) -> None:
    """With widths that share many columns with a probe, few, and an odd number; and under the brightest sun."""
    transport = build_transport(two_spheres(3), 500, 60, (height, width), 32, "cpu")
    generator = torch.Generator().manual_seed(1)
    sky = 0.01 + torch.rand(height * width, 3, generator=generator)
    sky[height * width // 3] = sun
    leaving = torch.rand(len(transport.irradiance_cache), 3, generator=generator)
    table = build_probes(transport, sky, leaving).radiance.double().numpy()
    table = table.reshape(-1, ALPHA_LEVELS, PROBE_ROWS, PROBE_COLUMNS, 3)

    seen = (transport.diffuse.sky.matrix > 0).numpy().reshape(-1, height, width)
    bounce = transport.diffuse.bounce.matrix.to_dense().double().numpy()
    toward, probe = directions(height, width), directions(PROBE_ROWS, PROBE_COLUMNS)
    edges = np.cos(np.linspace(0, math.pi, height + 1))
    solid = (edges[:-1] - edges[1:])[:, None]
    light = sky.double().numpy().reshape(height, width, 3)
    occluded_cells = bounce.sum(axis=1) > 1e-3
    assert occluded_cells.any() and not occluded_cells.all()
    chosen = [int(np.flatnonzero(occluded_cells)[0]), int(np.flatnonzero(~occluded_cells)[0]), 17]
    for cell in chosen:
        mean = leaving.double().numpy().mean(axis=0)
        if occluded_cells[cell]:
            mean = bounce[cell] @ leaving.double().numpy() / bounce[cell].sum()
        incident = np.where(seen[cell][..., None], light, mean)
        for level, row, column in ((0, 3, 0), (2, 12, 1), (4, 20, 2), (6, 8, 29), (1, 23, 47)):
            weight = lobe(probe[row, column], float(alpha_of(torch.tensor(float(level)))), toward) * solid
            expected = (incident * weight[..., None]).sum(axis=(0, 1)) / weight.sum()
            np.testing.assert_allclose(table[cell, level, row, column], expected, rtol=1e-3, atol=5e-8 * sun)
