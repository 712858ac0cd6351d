"""Membranes across surface that no photograph shows, on bodies of revolution whose right shape is known."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hir_core.capture import Camera
from hir_core.mesh.mesh_validity import inspect_mesh
from hir_plugins.initializers.hull.visual_hull import VisualHull
from hir_plugins.initializers.options import VisualHullOptions
from hir_plugins.initializers.surface import unseen_surface
from hir_plugins.initializers.surface.unseen_surface import THICKNESS_EDGES, with_membranes
from tests.fixtures.meshes import torus
from tests.fixtures.silhouette_captures import hits_boxes, look_at, shape_capture

Points = NDArray[np.float64]
Faces = NDArray[np.int64]

AROUND = 120
"""Vertices around the axis."""
EDGE = 0.05
TURNTABLE = 20.0
"""Elevation of the lowest cameras, in degrees."""


def revolved(corners: Sequence[tuple[float, float]]) -> tuple[Points, Faces]:
    """A closed surface around +z through (radius, height) from its lowest to its highest point, with even edges."""
    profile = [corners[0]]
    for (r0, z0), (r1, z1) in itertools.pairwise(corners):
        steps = max(1, round(float(np.hypot(r1 - r0, z1 - z0)) / EDGE))
        profile += [(r0 + (r1 - r0) * i / steps, z0 + (z1 - z0) * i / steps) for i in range(1, steps + 1)]
    rings = profile[1:-1]
    angle = 2 * np.pi * np.arange(AROUND) / AROUND
    points = [np.array([[0, 0, profile[0][1]]])]
    points += [np.stack([r * np.cos(angle), r * np.sin(angle), np.full(AROUND, z)], axis=1) for r, z in rings]
    points.append(np.array([[0, 0, profile[-1][1]]]))
    own = np.arange(AROUND)
    after = (own + 1) % AROUND
    last = 1 + AROUND * len(rings)
    faces = [np.stack([np.zeros(AROUND, int), 1 + after, 1 + own], axis=1)]
    for i in range(len(rings) - 1):
        low, high = 1 + AROUND * i, 1 + AROUND * (i + 1)
        faces.append(np.stack([low + own, low + after, high + after], axis=1))
        faces.append(np.stack([low + own, high + after, high + own], axis=1))
    top = 1 + AROUND * (len(rings) - 1)
    faces.append(np.stack([top + own, top + after, np.full(AROUND, last)], axis=1))
    return np.concatenate(points), np.concatenate(faces).astype(np.int64)


def ring_of_cameras(*elevations: float) -> list[Camera]:
    """Twelve cameras around the axis at each elevation, in degrees."""
    found = []
    for elevation in np.radians(elevations):
        for azimuth in 2 * np.pi * np.arange(12) / 12:
            level = np.array([np.cos(azimuth), np.sin(azimuth), 0]) * np.cos(elevation)
            place = 4 * (level + np.array([0, 0, np.sin(elevation)]))
            found.append(look_at(place, np.zeros(3), 140.0, 128, 128))
    return found


def hull_of_a_cylinder(elevation: float) -> tuple[Points, Faces]:
    """Of radius and height 1 on the plane z = 0, with the cone that cameras at `elevation` degrees leave below it."""
    return revolved([(0, -float(np.tan(np.radians(elevation)))), (1, 0), (1, 1), (0, 1)])


@pytest.mark.parametrize("elevation", [3.0, TURNTABLE])
def test_a_cone_below_a_base_becomes_flat(elevation: float) -> None:
    positions, faces = hull_of_a_cylinder(elevation)
    moved, report = with_membranes(positions, faces, ring_of_cameras(elevation, 50))
    depth = float(np.tan(np.radians(elevation)))
    assert moved[:, 2].min() > -0.05 * depth
    above = positions[:, 2] >= 0
    np.testing.assert_array_equal(moved[above], positions[above])
    cone, cylinder = depth / 3, 1.0
    assert report.volume_lost == pytest.approx(cone / (cone + cylinder), rel=0.05)
    assert report.moved_vertices == np.any(moved != positions, axis=1).sum()
    state = inspect_mesh(moved, faces)
    assert state.self_intersecting == 0 and state.folded == 0


def test_what_cameras_see_from_below_stays() -> None:
    positions, faces = hull_of_a_cylinder(TURNTABLE)
    moved, report = with_membranes(positions, faces, ring_of_cameras(TURNTABLE, 50, -50))
    np.testing.assert_array_equal(moved, positions)
    assert report.area_share == 0 and report.moved_vertices == 0 and report.volume_lost == 0


def test_the_hull_of_a_ball_stays() -> None:
    # the cone touches the ball where the lowest cameras see it end, without an edge
    touch = np.radians(90 - TURNTABLE)
    arc = [(float(np.cos(t)), float(np.sin(t))) for t in np.linspace(-touch, np.pi / 2, 60)]
    positions, faces = revolved([(0, -1 / float(np.cos(np.radians(TURNTABLE)))), *arc[:-1], (0, 1)])
    moved, report = with_membranes(positions, faces, ring_of_cameras(TURNTABLE, 50))
    assert report.area_share > 0.02
    assert np.abs(moved - positions).max() < 0.1 * EDGE


@pytest.mark.parametrize("elevation", [3.0, TURNTABLE])
def test_a_thin_rod_stays_round(elevation: float, monkeypatch: pytest.MonkeyPatch) -> None:
    # a rod a few edges thick: its normals turn by more than `EDGE_DEGREES` across the rim of its underside
    positions, faces = torus(around=240, tube=24, small=0.1)
    cameras = ring_of_cameras(elevation, 50, 80)
    moved, report = with_membranes(positions, faces, cameras)
    np.testing.assert_array_equal(moved, positions)
    assert report.area_share > 0.05
    monkeypatch.setattr(unseen_surface, "EDGE_DEGREES_TIMES_DISTANCE", 0)
    assert with_membranes(positions, faces, cameras)[1].moved_vertices > 0


def test_a_well_that_no_camera_looks_into_is_not_filled() -> None:
    positions, faces = revolved([(0, 0), (1, 0), (1, 1.5), (0.2, 1.5), (0.2, 0.3), (0, 0.3)])
    moved, report = with_membranes(positions, faces, ring_of_cameras(50, -50))
    np.testing.assert_array_equal(moved, positions)
    assert report.area_share > 0.05


def test_a_membrane_stays_below_the_inside_of_a_bowl() -> None:
    # its flaring outside is not seen from above, and the membrane across its rim would cut the inside
    positions, faces = revolved([(0, -0.3), (1, 0.3), (0.9, 0.35), (0, -0.1)])
    moved, report = with_membranes(positions, faces, ring_of_cameras(40, 70))
    assert report.moved_vertices > 0
    inside = positions[:, 2] > 0.35 - (0.9 - np.hypot(positions[:, 0], positions[:, 1])) * 0.5 - 1e-9
    np.testing.assert_array_equal(moved[inside], positions[inside])
    below_middle = moved[0, 2]
    assert positions[0, 2] < below_middle < -0.1 - 0.5 * THICKNESS_EDGES * EDGE
    assert inspect_mesh(moved, faces).self_intersecting == 0


def test_a_component_that_no_camera_sees_stays() -> None:
    # nothing holds a component whose whole surface is unseen
    positions, faces = hull_of_a_cylinder(TURNTABLE)
    far = positions * 0.3 + [0, 0, -40]
    both = np.concatenate([positions, far]), np.concatenate([faces, faces + len(positions)])
    moved, _ = with_membranes(*both, ring_of_cameras(TURNTABLE, 50))
    np.testing.assert_array_equal(moved[len(positions) :], far)


def test_the_hull_of_a_box_on_a_table() -> None:
    box = hits_boxes(np.array([[[-0.5, -0.5, 0.0], [0.5, 0.5, 0.6]]]))
    capture = shape_capture(ring_of_cameras(25, 55), box)
    membrane, hull = (VisualHull(VisualHullOptions(unseen_surface=each)) for each in ("membrane", "hull"))
    lowest = []
    for initializer in (membrane, hull):
        _, scene = initializer.initialize(capture, None, Path("unused"))
        assert scene is not None
        lowest.append(float(scene.mesh.positions[:, 2].min()))
    assert lowest[0] > -0.06 and lowest[1] < -0.15
    assert membrane.report()["volume_lost"] > 0.05  # type: ignore[operator]
    assert hull.report() == {}
