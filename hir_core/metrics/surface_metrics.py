"""Errors of a mesh against the true one: distances, F-score, normals.

Points are sampled uniformly by area on either surface; the distance is to the nearest point on the *triangles* of the
other. So equal surfaces have distance 0 for every triangulation, and no figure depends on the sampling of the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Camera
from hir_core.mesh.ray_casting import MeshQueries

Positions = NDArray[np.floating]
Faces = NDArray[np.integer]

SAMPLES: Final = 100_000
THRESHOLDS: Final = (0.005, 0.01, 0.02)
"""Distances, in radii of the truth, within which a point is correct (F-score, Knapitsch et al. 2017)."""


@dataclass(frozen=True)
class SurfaceFigures:
    """Distances in radii of the true object: half the diagonal of its box."""

    accuracy: float
    """Mean distance of the fit's points from the truth."""
    completeness: float
    """Mean distance of the truth's points from the fit."""
    chamfer_squared: float
    """Mean of the mean squared distances both ways, as Stanford-ORB has it, in squared radii."""
    normal_error_deg: float
    """Mean angle between the normals of a point and of its nearest point, over both directions."""
    f_score: Mapping[float, float]
    """Harmonic mean of precision and recall, by threshold."""

    @property
    def chamfer(self) -> float:
        """Mean of accuracy and completeness."""
        return 0.5 * (self.accuracy + self.completeness)

    def document(self) -> dict[str, Any]:
        """For metrics.json."""
        return {
            "chamfer": self.chamfer,
            "accuracy": self.accuracy,
            "completeness": self.completeness,
            "chamfer_squared": self.chamfer_squared,
            "normal_error_deg": self.normal_error_deg,
            "f_score": {f"{threshold:g}": value for threshold, value in self.f_score.items()},
        }


def compare_surfaces(
    fit: tuple[Positions, Faces], truth: tuple[Positions, Faces], cameras: Sequence[Camera] = (), samples: int = SAMPLES
) -> SurfaceFigures:
    """Figures of one mesh against another in the same frame; each is (V, 3) and (F, 3).

    With `cameras`, only those points of the truth count that are visible in one of them.
    """
    low, high = (getattr(np, f)(truth[0], axis=0) for f in ("min", "max"))
    center, radius = (low + high) / 2, 0.5 * float(np.linalg.norm(high - low))
    fit, truth = (((mesh[0] - center) / radius, np.asarray(mesh[1])) for mesh in (fit, truth))
    ours, our_normals = sample_surface(*fit, samples, seed=1)
    theirs, their_normals = sample_surface(*truth, samples, seed=2)
    if cameras:
        moved = [camera.transformed(_similarity(center, radius)) for camera in cameras]
        seen = visible(theirs, their_normals, truth, moved)
        theirs, their_normals = theirs[seen], their_normals[seen]
    to_truth, truth_faces = MeshQueries(*truth).nearest(ours)
    to_fit, fit_faces = MeshQueries(*fit).nearest(theirs)
    angles = np.concatenate(
        [
            angles_deg(our_normals, face_normals(*truth)[truth_faces]),
            angles_deg(their_normals, face_normals(*fit)[fit_faces]),
        ]
    )
    return SurfaceFigures(
        float(to_truth.mean()),
        float(to_fit.mean()),
        float(0.5 * ((to_truth**2).mean() + (to_fit**2).mean())),
        float(angles.mean()),
        {t: f_score(float((to_truth <= t).mean()), float((to_fit <= t).mean())) for t in THRESHOLDS},
    )


def f_score(precision: float, recall: float) -> float:
    """Harmonic mean; 0 where both are 0."""
    return 2 * precision * recall / (precision + recall) if precision + recall > 0 else 0.0


def sample_surface(
    positions: Positions, faces: Faces, count: int, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points (N, 3), even by area, and the unit normals of their faces; the same ones for the same seed."""
    random = np.random.default_rng(seed)
    corners = np.asarray(positions, np.float64)[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    face = random.choice(len(faces), count, p=area / area.sum())
    root, second = np.sqrt(random.random(count)), random.random(count)
    weights = np.stack([1 - root, root * (1 - second), root * second], axis=1)
    return (corners[face] * weights[..., None]).sum(axis=1), cross[face] / area[face, None]


def face_normals(positions: Positions, faces: Faces) -> NDArray[np.float64]:
    """Unit normals (F, 3); zero where a face has no area."""
    corners = np.asarray(positions, np.float64)[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300))


def angles_deg(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles (N,) between unit vectors (N, 3)."""
    return np.asarray(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1))))


def visible(
    points: NDArray[np.float64], normals: NDArray[np.float64], mesh: tuple[Positions, Faces], cameras: Sequence[Camera]
) -> NDArray[np.bool_]:
    """Whether points (N,) of a surface are visible in some camera: in its frame, front-facing, not occluded."""
    rays = MeshQueries(np.asarray(mesh[0], np.float32), np.asarray(mesh[1], np.int64))
    lifted = points + 1e-3 * normals
    seen = np.zeros(len(points), dtype=bool)
    for camera in cameras:
        pixel, depth = camera.project(points)
        inside = ((pixel >= 0) & (pixel <= [camera.width, camera.height])).all(axis=1) & (depth > 0)
        toward = camera.center - lifted
        candidates = np.flatnonzero(inside & ~seen & ((toward * normals).sum(axis=1) > 0))
        # rays continue behind the camera, where the object cannot be
        occluded = rays.occluded(lifted[candidates].astype(np.float32), toward[candidates].astype(np.float32))
        seen[candidates[~occluded]] = True
    return seen


def _similarity(center: NDArray[np.floating], radius: float) -> NDArray[np.float64]:
    """4×4 that moves `center` to the origin and shrinks by `radius`."""
    moved = np.eye(4)
    moved[:3, :3] /= radius
    moved[:3, 3] = -np.asarray(center) / radius
    return moved
