"""Poses from silhouettes: each mask's outline against the visual hull of other views, by Gauss-Newton steps.

The outline of the hull crosses rows and columns of the image at points of the hull's surface. A pose is moved until
the mask's signed distance is zero there (iterative closest points, with the mask's distance field in place of pairs).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import median_abs_deviation

from hir_core.capture import Array, Camera
from hir_plugins.initializers.refinement.cross_hulls import fold_of_views, hull_box, hulls_of_others
from hir_plugins.initializers.refinement.outline_points import OutlinePoints, outline_points, sample_with_slope
from hir_plugins.initializers.refinement.rotation_vectors import rotation_of_vector, vector_of_rotation
from hir_plugins.initializers.surface.silhouette_fields import SilhouetteField, focus_and_radius

_STEPS = 3
"""Gauss-Newton steps between two hulls."""
_NOISE_PIXELS = 0.7
"""Least standard deviation of the hull's outline against a mask: that of right cameras."""
_INDEPENDENT_POINTS = 60.0
"""Errors of neighbouring points of an outline are equal: a whole outline is worth about so many independent ones."""
_HUBER = 2.0
"""Beyond so many standard deviations a point's weight falls: parts of the object that the hull lacks."""
_PRIOR = 0.005
"""Scale of the error of a given camera along each axis, in radians and in distances from the object. It decides along
the motions that no silhouette shows, such as the turn of a vase."""
_PRIOR_FREEDOM = 4.0
"""Degrees of freedom of the prior, a multivariate t distribution: a few cameras are far more wrong than most."""
_MIN_POINTS = 12


def refine_poses(
    fields: Sequence[SilhouetteField], rounds: int, report: Callable[[int], None] = lambda done: None
) -> list[SilhouetteField]:
    """The views with cameras whose silhouettes agree with each other, in a world that may differ by a similarity."""
    current, given = list(fields), [field.camera for field in fields]
    fold = fold_of_views(len(fields))
    focus, _ = focus_and_radius(current)
    box = hull_box(current)
    for done in range(rounds):
        points: list[OutlinePoints] = [OutlinePoints.none()] * len(current)
        for each, hull in enumerate(hulls_of_others(current, box)):
            own = np.flatnonzero(fold == each).tolist()
            for view, found in zip(own, outline_points(*hull, [current[i].camera for i in own]), strict=True):
                points[view] = found
        current = moved_to_outlines(current, given, points, focus)
        report(done + 1)
    return current


def moved_to_outlines(
    fields: Sequence[SilhouetteField], given: Sequence[Camera], points: Sequence[OutlinePoints], focus: Array
) -> list[SilhouetteField]:
    """The views with poses for which the outline points lie on their masks' outlines.

    What all views have in common is the hull's error, not that of a pose: the median distance is subtracted.
    """
    distances = [_distances(field, each)[0] for field, each in zip(fields, points, strict=True)]
    together = np.concatenate(distances)
    bias = float(np.median(together)) if len(together) else 0.0
    # the hull of wrong cameras is wrong, too: what it says counts less until it agrees with the masks
    deviation = float(median_abs_deviation(together, scale="normal")) if len(together) else 0.0
    noise = max(_NOISE_PIXELS, deviation)
    return [
        replace(field, camera=_fitted_pose(field, camera, each, bias, noise, focus))
        for field, camera, each in zip(fields, given, points, strict=True)
    ]


def _distances(field: SilhouetteField, points: OutlinePoints) -> tuple[Array, Array]:
    pixels, _ = field.camera.project(points.positions)
    return sample_with_slope(field.distance, pixels)


def _fitted_pose(
    field: SilhouetteField, given: Camera, points: OutlinePoints, bias: float, noise: float, focus: Array
) -> Camera:
    if len(points.positions) < _MIN_POINTS:
        return field.camera
    camera, share = field.camera, _INDEPENDENT_POINTS / len(points.positions) / noise**2
    for _ in range(_STEPS):
        distance, slope = _distances(replace(field, camera=camera), points)
        residual = distance - bias
        jacobian, pivot = _derivative(camera, points.positions, slope, focus)
        weight = share * points.weights / np.maximum(1.0, np.abs(residual) / (_HUBER * noise))
        motion = _motion(camera, given, focus)
        prior = (_PRIOR_FREEDOM + 6) / (_PRIOR_FREEDOM + motion @ motion / _PRIOR**2) / _PRIOR**2
        normal = jacobian.T @ (jacobian * weight[:, None]) + np.eye(6) * prior
        right = jacobian.T @ (weight * residual) + motion * prior
        step = -np.linalg.solve(normal, right)
        turn = rotation_of_vector(step[:3])
        pose = np.eye(4)
        pose[:3, :3] = turn @ camera.world_to_camera[:3, :3]
        moved = turn @ (camera.world_to_camera[:3, 3] - pivot) + pivot
        pose[:3, 3] = moved + step[3:] * float(np.linalg.norm(pivot))
        camera = replace(camera, world_to_camera=pose)
    return camera


def _derivative(camera: Camera, positions: Array, slope: Array, focus: Array) -> tuple[Array, Array]:
    """Of a value with this `slope` in the image (N, 6): by a turn about the focus, and by a move in units of its
    distance. Also the focus in the camera's axes (3,)."""
    rotation, translation = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
    local, pivot = positions @ rotation.T + translation, rotation @ focus + translation
    depth = local[:, 2:]
    by_image_plane = slope @ camera.intrinsics[:2, :2] / depth
    by_depth = -(by_image_plane * local[:, :2]).sum(axis=1, keepdims=True) / depth
    by_position = np.concatenate([by_image_plane, by_depth], axis=1)
    turn = np.cross(local - pivot, by_position)
    return np.concatenate([turn, by_position * float(np.linalg.norm(pivot))], axis=1), pivot


def _motion(camera: Camera, given: Camera, focus: Array) -> Array:
    """From the given pose (6,): turn, and move of the focus in the camera's axes in units of its distance."""
    turn = camera.world_to_camera[:3, :3] @ given.world_to_camera[:3, :3].T
    new = camera.world_to_camera[:3, :3] @ focus + camera.world_to_camera[:3, 3]
    old = given.world_to_camera[:3, :3] @ focus + given.world_to_camera[:3, 3]
    return np.concatenate([vector_of_rotation(turn), (new - old) / float(np.linalg.norm(old))])
