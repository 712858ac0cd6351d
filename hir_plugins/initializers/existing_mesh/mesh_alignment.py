"""Aligns a mesh of unknown position, rotation and scale with a capture's points."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hir_core.capture import Array
from hir_core.errors import CaptureError

_SAMPLES = 20_000
_COARSE_SAMPLES = 1_500
_REFINED_CANDIDATES = 4
_TRIMMED_SHARE = 0.8
"""Share of the points, the nearest ones, that is used: the rest may belong to the background."""

_MAX_MEAN_DISTANCE = 0.03
"""Largest mean distance of an accepted alignment, relative to the mesh's longest side."""


def align_mesh(positions: Array, faces: NDArray[np.int64], points: Array, seed: int = 0) -> tuple[Array, float]:
    """4×4 similarity from the mesh to the points (N, 3), and the remaining mean distance relative to its longest side.

    Both are sampled, from `seed`. The 24 rotations of a cube are the initial guesses; the best are refined by ICP with
    scale (Besl & McKay 1992, open3d). Too few points, or no fit, raises `CaptureError`.
    """
    import open3d
    import trimesh

    if len(points) < 100:
        raise CaptureError(
            f"there are {len(points)} points to align the mesh with, at least 100 are needed; run colmap or stereo "
            "before, or set initializer.mesh_file.transform"
        )
    surface = trimesh.Trimesh(positions, faces, process=False).sample(_SAMPLES, seed=seed)
    rng = np.random.default_rng(seed)
    points = points[rng.permutation(len(points))[:_SAMPLES]]
    # each in its own unit frame, from medians because points have outliers
    to_unit, from_unit = _unit_from_points(surface), np.linalg.inv(_unit_from_points(points))
    mesh_unit = _transformed(surface, to_unit)
    cloud = _transformed(points, np.linalg.inv(from_unit))
    tree = cKDTree(mesh_unit)
    candidates = sorted(
        _axis_rotations(),
        key=lambda rotation: _trimmed_mean_distance(tree, _transformed(cloud[:_COARSE_SAMPLES], rotation)),
    )[:_REFINED_CANDIDATES]
    target, source = (open3d.geometry.PointCloud(open3d.utility.Vector3dVector(x)) for x in (mesh_unit, cloud))
    method = open3d.pipelines.registration.TransformationEstimationPointToPoint(True)
    fits: list[tuple[float, Array]] = []
    for candidate in candidates:
        transform = candidate
        for reach, rounds in ((0.6, 40), (0.2, 40), (0.08, 60)):
            ending = open3d.pipelines.registration.ICPConvergenceCriteria(max_iteration=rounds)
            result = open3d.pipelines.registration.registration_icp(source, target, reach, transform, method, ending)
            transform = np.asarray(result.transformation)
        if not np.isfinite(transform).all():
            continue  # no point was in reach
        scale = np.cbrt(np.linalg.det(transform[:3, :3]))
        if 0.3 < scale < 3:
            # measured at the mesh's scale: otherwise points shrunk into one would fit best
            fits.append((_trimmed_mean_distance(tree, _transformed(cloud, transform)), transform))
    size = float(np.ptp(mesh_unit, axis=0).max())
    best = min(fits, key=lambda f: f[0]) if fits else (np.inf, np.eye(4))
    if best[0] > _MAX_MEAN_DISTANCE * size:
        raise CaptureError(
            "the mesh does not fit the capture's points in any rotation "
            f"(mean distance {best[0] / size:.1%} of its size); check that it is the same object, or set "
            "initializer.mesh_file.transform"
        )
    return from_unit @ np.linalg.inv(best[1]) @ to_unit, float(best[0] / size)


def _unit_from_points(points: Array) -> Array:
    """4×4 transform to the frame in which the points' median is the origin and their median radius 1."""
    center = np.median(points, axis=0)
    radius = float(np.median(np.linalg.norm(points - center, axis=1))) or 1.0
    frame = np.eye(4)
    frame[:3] /= radius
    frame[:3, 3] = -center / radius
    return frame


def _axis_rotations() -> list[Array]:
    """The 24 rotations that map the axes onto each other."""
    rotations: list[Array] = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        rotation = np.eye(4)
        rotation[:3, :3] = np.eye(3)[list(order)] * np.array(signs)[:, None]
        if np.linalg.det(rotation) > 0:
            rotations.append(rotation)
    return rotations


def _transformed(points: Array, transform: Array) -> Array:
    return points @ transform[:3, :3].T + transform[:3, 3]


def _trimmed_mean_distance(tree: cKDTree, points: Array) -> float:
    """Mean distance to the tree of the `_TRIMMED_SHARE` nearest points."""
    distance = np.sort(tree.query(points)[0])
    return float(distance[: max(1, int(_TRIMMED_SHARE * len(distance)))].mean())
