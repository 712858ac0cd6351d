"""The irradiance cache: its number of cells is limited, and they are dense where normals vary."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hir_core.scene import Mesh, Scene, Topology
from hir_plugins.reflectance_renderers.mitsuba_ggx.options import MitsubaGGXOptions
from hir_plugins.reflectance_renderers.mitsuba_ggx.renderer import MitsubaGGX
from hir_plugins.reflectance_renderers.transport_ggx.operator.irradiance_cache import build_irradiance_cache
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import refine
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from tests.fixtures.scenes import bumpy_sphere, icosphere
from tests.hir_plugins.reflectance_renderers.transport_ggx.test_transport_ggx import (
    capture,
    gloss,
    pixels_of,
    radiance,
    smooth_light,
)


def drum() -> Mesh:
    """Two discs and a rim of 24 rectangles whose smooth normals change by a right angle from edge to edge."""
    import trimesh

    made = trimesh.creation.cylinder(radius=1.0, height=0.3, sections=24)
    upright = np.asarray(made.vertices)[:, [1, 2, 0]].astype(np.float32)
    return Mesh(torch.from_numpy(upright.copy()), Topology(torch.from_numpy(np.asarray(made.faces, dtype=np.int64))))


def normal_deviation_degrees(mesh: Mesh, max_cells: int) -> torch.Tensor:
    """Angle between each vertex's normal and its cell's."""
    surface = refine(mesh, 12_000)
    cells = build_irradiance_cache(surface, max_cells)
    assert 0.8 * max_cells < len(cells) <= max_cells and bool(
        (torch.bincount(cells.of_vertex, minlength=len(cells)) > 0).all()
    )
    return torch.rad2deg(torch.acos((cells.normals[cells.of_vertex] * surface.normals).sum(1).clamp(-1, 1)))


def test_cells_are_small_where_normals_vary() -> None:
    assert float(normal_deviation_degrees(drum(), 2500).quantile(0.95)) < 10
    assert float(normal_deviation_degrees(icosphere(5), 2500).quantile(0.95)) < 5


@pytest.mark.parametrize("max_cells", [50, 400, 3000])
def test_the_number_of_cells_is_limited(max_cells: int) -> None:
    normal_deviation_degrees(bumpy_sphere(5), max_cells)
    normal_deviation_degrees(drum(), max_cells)


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_cells_do_not_depend_on_the_unit(scale: float) -> None:
    surface, scaled = (refine(bumpy_sphere(4).with_positions(bumpy_sphere(4).positions * s), 0) for s in (1.0, scale))
    assert abs(len(build_irradiance_cache(surface, 600)) - len(build_irradiance_cache(scaled, 600))) < 10


def test_a_mesh_without_extent_has_a_cell() -> None:
    sphere = icosphere(3)
    cells = build_irradiance_cache(refine(sphere.with_positions(torch.zeros_like(sphere.positions)), 0), 20)
    assert len(cells) >= 1 and bool(torch.isfinite(cells.positions).all())


def test_a_coarse_rim_shades_as_the_path_tracer_shades_it() -> None:
    """Cells that are clustered by position only have a root mean square error of 7.0 %."""
    mesh, light, material = drum(), smooth_light(), gloss("paper", 0.5, 0.0, 0.5)
    shown = radiance(mesh, material, light, TransportGGXOptions(vertices=40_000, cache_cells=3000))
    torch.manual_seed(0)
    tracer = MitsubaGGX(MitsubaGGXOptions(samples=1024, max_depth=2)).prepare(Scene(mesh, material, light), capture())
    reference = tracer.radiance(material, light, pixels_of())
    both = (reference.sum(1) > 0) & (shown.sum(1) > 0)
    error = (shown - reference)[both].square().mean().sqrt() / reference[both].mean()
    assert int(both.sum()) > 100 and float(error) < 0.066
