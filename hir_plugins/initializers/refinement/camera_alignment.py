"""Refined cameras in the world of the given ones, and how far they moved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hir_core.capture import Array, Camera
from hir_plugins.initializers.refinement.rotation_vectors import vector_of_rotation

_ITERATIONS = 20


@dataclass(frozen=True)
class CameraMotion:
    """How far each camera moved (V,)."""

    degrees: Array
    percent: Array
    """Of its distance from the object."""


def aligned_cameras(refined: Sequence[Camera], given: Sequence[Camera], focus: Array) -> list[Camera]:
    """The refined cameras after the similarity that moves them nearest to the given ones: origin, axes and unit stay.

    The rotation comes from the cameras' axes and their centres: a turn by a milliradian counts as much as a move by a
    thousandth of the object's distance. Scale and translation come from the centres. Cameras that moved far count less
    (iteratively reweighted least squares).
    """
    reach = float(np.median([np.linalg.norm(camera.center - focus) for camera in given]))
    weights: Array = np.ones(len(refined))
    similarity: Array = np.eye(4)
    for _ in range(_ITERATIONS):
        similarity = _similarity(refined, given, weights / weights.sum(), reach)
        moved = [camera.transformed(similarity) for camera in refined]
        motion = camera_motion(moved, given, focus)
        miss = np.hypot(np.radians(motion.degrees), motion.percent / 100)
        weights = 1 / (1 + (miss / max(float(np.median(miss)), 1e-12)) ** 2)
    return [camera.transformed(similarity) for camera in refined]


def camera_motion(cameras: Sequence[Camera], given: Sequence[Camera], focus: Array) -> CameraMotion:
    """Angles and distances between two sets of cameras."""
    angles = [
        np.linalg.norm(vector_of_rotation(a.world_to_camera[:3, :3] @ b.world_to_camera[:3, :3].T))
        for a, b in zip(cameras, given, strict=True)
    ]
    moves = [
        np.linalg.norm(a.center - b.center) / np.linalg.norm(b.center - focus)
        for a, b in zip(cameras, given, strict=True)
    ]
    return CameraMotion(np.degrees(angles), 100 * np.array(moves))


def _similarity(source: Sequence[Camera], target: Sequence[Camera], weights: Array, reach: float) -> Array:
    """The 4×4 similarity of weighted least squares (Umeyama 1991, with the axes as further directions)."""
    a, b = (np.array([camera.center for camera in cameras]) for cameras in (source, target))
    mean_a, mean_b = weights @ a, weights @ b
    a, b = a - mean_a, b - mean_b
    ratio = float(np.sqrt((weights @ (b**2).sum(axis=1)) / max(weights @ (a**2).sum(axis=1), 1e-24)))
    axes_a, axes_b = (np.array([camera.world_to_camera[:3, :3] for camera in cameras]) for cameras in (source, target))
    across = ratio * (b * weights[:, None]).T @ a + reach**2 * np.einsum("v,vki,vkj->ij", weights, axes_b, axes_a)
    u, _, vt = np.linalg.svd(across)
    rotation = (u * [1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
    scale = float(weights @ (b * (a @ rotation.T)).sum(axis=1) / max(weights @ (a**2).sum(axis=1), 1e-24))
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = scale * rotation, mean_b - scale * rotation @ mean_a
    return result
