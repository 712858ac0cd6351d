"""From the world of a capture's own cameras to the world of estimated ones, so that held-out views stay comparable."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from hir_core.capture import Array, Camera, Capture

_MOST_POINTS, _MOST_VIEWS = 300, 60
"""Whose pictures are compared."""

_NEAR_PIXELS = 1.0
"""Differences beyond which the weight of a point falls."""


def solved_from_source(solved: Capture, original: Capture, seed: int) -> Array:
    """4×4 similarity from the files' world to the estimated one.

    The camera centres give the first one, and the pictures of the points the final one. Structure from motion of one
    object tells its distance and the focal length badly apart: with centres alone an object that is estimated nearer
    and with a shorter focal length appears too large to the capture's own cameras.
    """
    pairs = [
        (a.camera, b.camera)
        for a, b in zip(original.views, solved.views, strict=True)
        if a.camera is not None and b.camera is not None
    ]
    old, new = (np.array([each[side].center for each in pairs]) for side in (0, 1))
    options = pycolmap.RANSACOptions()
    options.max_error, options.random_seed = 0.05 * float(np.ptp(new, axis=0).max()), seed
    # pycolmap returns a dict here, not the Sim3d of its stubs
    fit: Any = pycolmap.estimate_sim3d_robust(old, new, options)
    if fit is None:
        warnings.warn(
            "the estimated cameras do not match the capture's own cameras; held-out views cannot be compared with "
            "this run",
            stacklevel=3,
        )
        return np.eye(4)
    similarity: Array = np.eye(4)
    similarity[:3] = fit["tgt_from_src"].matrix()
    if solved.points is not None:
        similarity = with_equal_pictures(similarity, solved.points.positions, pairs, seed)
    return similarity @ original.world_from_source


def with_equal_pictures(similarity: Array, points: Array, pairs: list[tuple[Camera, Camera]], seed: int) -> Array:
    """The 4×4 similarity, moved so that points (N, 3) of the new world appear at the same pixels in the old cameras as
    in the new ones.

    `pairs` has the old and the new camera of each photograph.
    """
    rng = np.random.default_rng(seed)
    points = rng.permutation(points)[:_MOST_POINTS]
    chosen = [pairs[i] for i in sorted(rng.permutation(len(pairs))[:_MOST_VIEWS])]
    seen = [_seen(points, new) for _, new in chosen]
    if not any(inside.any() for _, inside in seen):
        return similarity
    center = np.median(points, axis=0)
    radius = float(np.median(np.linalg.norm(points - center, axis=1)))
    to_old = np.linalg.inv(similarity)

    def moved(change: Array) -> Array:
        """4×4, in the new world: rotation vector, translation in radii, logarithm of the scale."""
        matrix = np.eye(4)
        matrix[:3, :3] = np.exp(change[6]) * Rotation.from_rotvec(change[:3]).as_matrix()
        matrix[:3, 3] = center + radius * change[3:6] - matrix[:3, :3] @ center
        return matrix

    def differences(change: Array) -> Array:
        matrix = to_old @ moved(change)
        there = points @ matrix[:3, :3].T + matrix[:3, 3]
        return np.concatenate(
            [
                (old.project(there[inside])[0] - pixels[inside]).ravel()
                for (old, _), (pixels, inside) in zip(chosen, seen, strict=True)
            ]
        )

    found = least_squares(differences, np.zeros(7), loss="cauchy", f_scale=_NEAR_PIXELS)
    return np.asarray(np.linalg.inv(moved(found.x)) @ similarity)


def _seen(points: Array, camera: Camera) -> tuple[Array, NDArray[np.bool_]]:
    """Pixels (N, 2), and which of the points lie in the picture."""
    pixels, depth = camera.project(points)
    size = np.array([camera.width, camera.height])
    return pixels, (depth > 0) & ((pixels >= 0) & (pixels < size)).all(axis=1)
