"""The mean direction of a lobe and its width: against quadrature, and in a light for which the lookup is exact."""

from __future__ import annotations

import math
from itertools import product

import mitsuba as mi
import numpy as np
import pytest
import torch
from hir_exporters.materials.brdf_numpy import (
    albedo_terms,
    ggx_distribution,
    half_vector_cosines,
    schlick_weight,
    smith_visibility,
)

from hir_plugins.reflectance_renderers.mitsuba_variant import mitsuba_on
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_pyramid import texel_directions
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.lobe_moments import (
    LEAST_COSINE,
    lobe_means,
    moment_table,
    width_table,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.probe_lookup import (
    ProbeTable,
    lobe_of,
    patch_around,
    patch_radiance,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.radiance_probes import (
    ALPHA_LEVELS,
    PROBE_COLUMNS,
    PROBE_ROWS,
    RadianceProbes,
    _lobes,
    level_of,
)

ROWS = 64


def weighted_lobe(alpha: float, cosine: float, rho_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Directions (N, 3) about the normal (0, 0, 1), and the lobe's weight of each, by midpoints of the hemisphere."""
    z, turn = (np.arange(600) + 0.5) / 600, (np.arange(240) + 0.5) / 240 * 2 * np.pi
    z, turn = np.meshgrid(z**2, turn, indexing="ij")  # finer near the horizon
    density = np.sqrt(z)
    radius = np.sqrt(1 - z * z)
    directions = np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=-1).reshape(-1, 3)
    eye = np.array([-math.sqrt(1 - cosine**2), 0, cosine])
    n_i, n_o, n_h, h_o = half_vector_cosines(directions, np.broadcast_to(eye, directions.shape))
    fresnel = rho_s + (1 - rho_s) * schlick_weight(h_o)
    weight = ggx_distribution(n_h, alpha) * smith_visibility(n_i, n_o, alpha) * fresnel * n_i * density.reshape(-1)
    return directions, weight


@pytest.mark.parametrize("alpha", [0.1, 0.3, 0.8])
@pytest.mark.parametrize("cosine", [0.15, 0.5, 0.95])
def test_means_are_those_of_quadrature(alpha: float, cosine: float) -> None:
    plain, schlick = lobe_means(np.array(cosine), np.array(alpha))
    scale, bias = albedo_terms(cosine, alpha)
    for rho_s in (0.02, 1.0):
        directions, weight = weighted_lobe(alpha, cosine, rho_s)
        mean = (directions * weight[:, None]).sum(axis=0) / weight.sum()
        found = (rho_s * scale * plain + bias * schlick) / (rho_s * scale + bias)
        assert np.abs(found - mean[[0, 2]]).max() < 0.01 and abs(mean[1]) < 1e-6
    assert np.linalg.norm(plain) < 1 and np.linalg.norm(schlick) < 1


def test_tables_are_finite_and_a_rougher_lobe_is_wider() -> None:
    table, widths = moment_table(), width_table()
    assert np.isfinite(table).all() and np.isfinite(widths).all() and (np.diff(widths) >= 0).all()
    assert not table.flags.writeable and not widths.flags.writeable
    lengths = np.linalg.norm(lobe_means(np.full(9, 0.6), np.geomspace(0.05, 1, 9))[0], axis=-1)
    assert (np.diff(lengths) < 0).all()
    grazing = lobe_means(np.full(9, LEAST_COSINE), np.geomspace(0.02, 1, 9))
    assert np.isfinite(grazing[0]).all() and np.isfinite(grazing[1]).all()


def test_a_light_that_is_linear_in_the_direction_is_looked_up_exactly() -> None:
    """The integral of such a light over a lobe depends on the lobe's mean alone; views from 18° to 81° off the normal.

    Cut at the horizon of the looked-up direction, the symmetric lobe keeps a small error.
    """
    mitsuba_on("cpu")
    toward_light = torch.tensor([0.6, -0.5, 0.62])
    sky = 1 + 0.8 * texel_directions(ROWS, 2 * ROWS) @ toward_light
    lobes = _lobes(ROWS, 2 * ROWS, PROBE_COLUMNS).flatten(1)
    filtered = (lobes @ sky).reshape(1, ALPHA_LEVELS, PROBE_ROWS * PROBE_COLUMNS, 1)
    probes = ProbeTable(RadianceProbes(filtered.expand(-1, -1, -1, 3).half()))
    for rho_s, alpha, cosine in product((0.02, 0.7), (0.15, 0.35, 0.7), (0.15, 0.4, 0.7, 0.95)):
        eye = mi.Vector3f(-math.sqrt(1 - cosine**2), 0, cosine)
        level = mi.Float(float(level_of(torch.tensor(alpha))))
        lobe = lobe_of(mi.Vector3f(0, 0, 1), eye, level, mi.Float(rho_s), 1.0)
        found = float(np.array(patch_radiance(patch_around(probes.values, mi.UInt32(0), lobe), lobe))[0, 0])
        directions, weight = weighted_lobe(alpha, cosine, rho_s)
        light = 1 + 0.8 * directions @ toward_light.numpy()
        assert found == pytest.approx(float((light * weight).sum() / weight.sum()), rel=0.03), (rho_s, alpha, cosine)
