"""Silhouettes of surfaces behind the camera, through its plane, duplicated; overlaps of empty masks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from hir_core.capture import Camera
from hir_core.scene import Mesh, Topology
from hir_core.scene.silhouette_targets import SilhouetteTargets, intersection_over_union
from hir_core.stages.geometry.silhouettes.robust_view_weights import RobustViewWeights
from hir_plugins.geometry_renderers.contour import Contour
from hir_plugins.geometry_renderers.options import ContourOptions
from tests.stability.case import Case

_SIZE = 64
_CAMERA = Camera(np.array([[60.0, 0, 32], [0, 60.0, 32], [0, 0, 1]]), np.eye(4), _SIZE, _SIZE)
_SQUARE = np.array([[-0.5, -0.5, 2.0], [0.5, -0.5, 2], [0.5, 0.5, 2], [-0.5, 0.5, 2]])
_FACES = np.array([[0, 1, 2], [0, 2, 3]])
_AREA = 30.0**2
"""The square is 30 pixels wide."""
_NAIVE = "½ Σ |(p₁−p₀)×(p₂−p₀)| of the projected triangles that face the camera"


def _targets() -> SilhouetteTargets:
    mask = torch.zeros(_SIZE, _SIZE)
    mask[17:47, 17:47] = 1.0
    return SilhouetteTargets((_CAMERA,), (mask,))


def _overlap(positions: np.ndarray, faces: np.ndarray, which: int) -> torch.Tensor:
    mesh = Mesh(torch.tensor(positions, dtype=torch.float32), Topology(torch.tensor(faces)))
    return Contour(ContourOptions()).overlap(mesh, _targets())[which][0]


def _summed(positions: np.ndarray, faces: np.ndarray) -> float:
    """Each triangle alone, in both orientations."""
    p = positions.astype(np.float32)
    pixels = p[:, :2] * np.float32(60) / p[:, 2:] + np.float32(32)
    a, b, c = pixels[faces[:, 0]], pixels[faces[:, 1]], pixels[faces[:, 2]]
    u, v = b - a, c - a
    return float(np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum() / 2)


def _areas() -> list[Case]:
    behind = _SQUARE * [1, 1, -1]
    through = np.array([[-0.5, -0.2, 2.0], [0.5, -0.2, 2.0], [0.5, -1.0, -2.0], [-0.5, -1.0, -2.0]])
    fold = np.vstack([_SQUARE, [[-0.5, -0.5, 2.2], [0.5, -0.5, 2.2]]])
    touching = np.array([[-0.5, -0.2, 2.0], [0.5, -0.2, 2.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]])
    shapes = {
        "a duplicated square": (_SQUARE, np.vstack([_FACES, _FACES]), _AREA),
        "a square and its back": (_SQUARE, np.vstack([_FACES, _FACES[:, ::-1]]), _AREA),
        "a fin of three faces on one edge": (fold, np.vstack([_FACES, [[0, 1, 4], [1, 5, 4]]]), _AREA),
        "a square behind the camera": (behind, _FACES, 0.0),
        "one square in front, one behind": (np.vstack([_SQUARE, behind]), np.vstack([_FACES, _FACES + 4]), _AREA),
        "a triangle with a corner used twice": (_SQUARE, np.vstack([_FACES, _FACES, [[0, 0, 1]]]), _AREA),
    }
    cases = [
        Case(
            "geometry",
            "hir_plugins.geometry_renderers.contour.Contour.overlap",
            f"area of {name}",
            f"{truth:g} pixels",
            lambda p=p, f=f: _overlap(p, f, 0),
            lambda p=p, f=f: _summed(p, f),
            truth,
            tolerance=1e-5,
            formula=_NAIVE,
        )
        for name, (p, f, truth) in shapes.items()
    ]
    # from the line y = −0.2 at depth 2 on, upwards or downwards beyond the mask
    for name, positions in (
        ("that runs through the camera's plane", through),
        ("that ends in the camera's plane", touching),
    ):
        cases.append(
            Case(
                "geometry",
                "hir_plugins.geometry_renderers.contour.Contour.overlap",
                f"overlap of a square {name}",
                "the part in front of the camera, to 0.01 pixel",
                lambda p=positions: _overlap(p, _FACES, 1),
                lambda p=positions: _summed(p, _FACES),
                lambda p=positions: _clipped(p),
                tolerance=3e-5,
                formula=_NAIVE,
            )
        )
    return cases


def _clipped(positions: np.ndarray) -> float:
    """Overlap with the mask of the part in front of a plane close to the camera, as polygons (shapely, float64)."""
    from shapely import Polygon, box

    near, corners = 1e-6, []
    p = positions.astype(np.float32).astype(np.float64)
    for a, b in zip(p, np.roll(p, -1, axis=0), strict=True):
        if a[2] > near:
            corners.append(a)
        if (a[2] > near) != (b[2] > near):
            corners.append(a + (near - a[2]) / (b[2] - a[2]) * (b - a))
    pixels = np.array([[c[0] * 60 / c[2] + 32, c[1] * 60 / c[2] + 32] for c in corners])
    return float(Polygon(pixels).intersection(box(17, 17, 47, 47)).area)


def _ratios() -> list[Case]:
    zero = torch.zeros(1, dtype=torch.float64)

    def gradient(formula: Callable[..., torch.Tensor]) -> float:
        area, inner = zero.clone().requires_grad_(), zero.clone().requires_grad_()
        formula(area, inner, zero).sum().backward()
        return float(sum((~torch.isfinite(g)).sum() for g in (area.grad, inner.grad)))

    def plain(area: torch.Tensor, inner: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
        return inner / (area + mask - inner)

    view_weights = RobustViewWeights(6)
    view_weights.update(list(range(6)), np.zeros(6), active=True)
    return [
        Case(
            "geometry",
            "hir_core.scene.silhouette_targets.intersection_over_union",
            "an empty silhouette and an empty mask",
            "1",
            lambda: intersection_over_union(zero, zero, zero)[0],
            lambda: plain(zero, zero, zero)[0],
            1.0,
            formula="I / (A + M − I)",
        ),
        Case(
            "geometry",
            "hir_core.scene.silhouette_targets.intersection_over_union",
            "its gradient there",
            "0 values that are not finite",
            lambda: gradient(intersection_over_union),
            lambda: gradient(plain),
            0.0,
            formula="I / (A + M − I), differentiated",
        ),
        Case(
            "geometry",
            "hir_core.stages.geometry.silhouettes.robust_view_weights.RobustViewWeights.update",
            "views that all fit perfectly",
            "weights of 1",
            lambda: view_weights.update([0, 1], np.zeros(2), active=True),
            lambda: (3 * np.zeros(2) / np.zeros(2)) ** 2,
            lambda: np.ones(2),
            formula="(3 · median / error)²",
        ),
    ]


CASES = [*_areas(), *_ratios()]
