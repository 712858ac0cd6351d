"""The way from a capture's own cameras to estimated ones keeps the pictures of the object."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hir_core.capture import Array, Camera, Capture, OrientedPoints
from hir_plugins.initializers.sfm.source_alignment import solved_from_source
from tests.fixtures.silhouette_captures import dome, make_view

SIDE = 200
POINTS = np.random.default_rng(0).normal(size=(200, 3)) * [0.4, 0.3, 0.35]


def capture_of(cameras: list[Camera], points: Array | None = None) -> Capture:
    empty = np.zeros((SIDE, SIDE), np.float32)
    views = tuple(make_view(str(i), camera, empty) for i, camera in enumerate(cameras))
    return replace(
        Capture(Path("made-in-memory"), views), points=None if points is None else OrientedPoints(positions=points)
    )


def estimated(camera: Camera, shorter: float, world: Array) -> Camera:
    """A camera with a shorter focal length that is as much nearer, in another world."""
    intrinsics = camera.intrinsics.copy()
    intrinsics[[0, 1], [0, 1]] *= shorter
    pose = camera.world_to_camera.copy()
    pose[:3, 3] = shorter * (camera.world_to_camera @ [0, 0, 0, 1])[:3]
    scale = np.cbrt(np.linalg.det(world[:3, :3]))
    moved = pose @ np.linalg.inv(world)
    moved[:3] *= scale
    return replace(camera, intrinsics=intrinsics, world_to_camera=moved)


@pytest.mark.parametrize("shorter", [1.0, 0.97])
@pytest.mark.parametrize("outliers", [0, 2])
def test_points_keep_their_pixels(shorter: float, outliers: int) -> None:
    world = np.eye(4)
    world[:3, :3] = 2.5 * Rotation.from_rotvec([0.3, -1.0, 0.5]).as_matrix()
    world[:3, 3] = 4.0, -2.0, 1.0
    given = dome(16, 3.0, np.zeros(3), 1.6 * SIDE, SIDE)
    found = [estimated(camera, shorter, world) for camera in given]
    for i in range(outliers):
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_rotvec([0, 0.2, 0]).as_matrix()
        found[5 * i] = replace(found[5 * i], world_to_camera=found[5 * i].world_to_camera @ turn)
    points = POINTS @ world[:3, :3].T + world[:3, 3]
    solved = capture_of(found, points)
    similarity = solved_from_source(solved, capture_of(given), seed=0)
    back = np.linalg.inv(similarity)
    there = points @ back[:3, :3].T + back[:3, 3]
    differences = np.concatenate(
        [old.project(there)[0] - old.project(POINTS)[0] for i, old in enumerate(given) if i % 5 or not outliers]
    )
    if shorter == 1:
        assert np.abs(differences).max() < (0.1 if outliers else 0.01)
    # what is left of 3 % of the size, 2.5 pixels, is perspective
    assert np.sqrt((differences**2).mean()) < 0.3
    centers = solved_from_source(capture_of(found), capture_of(given), seed=0)
    size = np.cbrt(np.linalg.det(similarity[:3, :3])) / np.cbrt(np.linalg.det(centers[:3, :3]))
    assert size == pytest.approx(1 / shorter, rel=5e-3), "of the object, against that by the camera centres"


def test_points_that_no_camera_sees_change_nothing() -> None:
    given = dome(16, 3.0, np.zeros(3), 1.6 * SIDE, SIDE)
    behind = capture_of(given, POINTS + np.array([0.0, 100.0, 0.0]))
    assert solved_from_source(behind, capture_of(given), seed=0) == pytest.approx(np.eye(4), abs=1e-9)
