"""Pixels that an outline of a mesh may cross: all others lie inside or outside its silhouette as a whole.

The silhouette changes only across the image of an edge whose triangles face different ways, or that has one triangle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray

from hir_core.capture import Camera

_STEP_PIXELS = 0.5
"""Distance of the points at which an edge marks the pixels around it: each pixel that it crosses is a neighbour of the
pixel of one of them."""
_MAX_POINTS_PER_PIXEL = 16
"""Of the whole image; a mesh with more outline than that is not worth the search."""
_LEAST_DEPTH = 1e-3
"""Share of the farthest depth below which the image of a point is not computed."""


@dataclass(frozen=True, eq=False)
class OutlineEdges:
    """The edges of a mesh with the faces on both sides."""

    positions: Float[NDArray[np.float64], "V 3"]
    ends: Int[NDArray[np.int64], "E 2"]
    sides: Int[NDArray[np.int64], "E 2"]
    """Faces; the same one twice where an edge has one, or more than two."""
    normals: Float[NDArray[np.float64], "F 3"]
    """Of faces, with any length."""
    corner: Int[NDArray[np.int64], " F"]
    """A vertex of each face."""

    @classmethod
    def of(cls, positions: NDArray[np.float64], faces: NDArray[np.integer]) -> OutlineEdges:
        """The edges of triangles (F, 3). Vertices at equal positions should be one: else both edges there are outlines,
        which marks more pixels than need be."""
        a, b, c = (positions[faces[:, k]] for k in range(3))
        corners = np.sort(
            np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64), axis=1
        )
        owner = np.tile(np.arange(len(faces)), 3)
        key = corners[:, 0] * len(positions) + corners[:, 1]
        order = np.argsort(key, kind="stable")
        _, first, count = np.unique(key[order], return_index=True, return_counts=True)
        one = owner[order][first]
        other = np.where(count == 2, owner[order][np.minimum(first + 1, len(order) - 1)], one)
        normals = np.cross(b - a, c - a)
        return cls(
            positions, corners[order][first], np.stack([one, other], axis=1), normals, faces[:, 0].astype(np.int64)
        )

    def pixels(self, camera: Camera) -> Bool[NDArray[np.bool_], "H W"]:
        """Pixels that an outline may cross.

        All of them where a vertex is beside or behind the camera, or where outlines fill the image.
        """
        image, depth = camera.project(self.positions)
        marked = np.zeros((camera.height, camera.width), bool)
        if float(depth.min()) <= _LEAST_DEPTH * float(np.abs(depth).max()):
            return ~marked
        facing = (self.normals * (camera.center - self.positions[self.corner])).sum(axis=1) > 0
        one, other = self.sides.T
        outline = self.ends[(facing[one] != facing[other]) | (one == other)]
        start, end = image[outline[:, 0]], image[outline[:, 1]]
        size = np.array([camera.width, camera.height])
        seen = (np.maximum(start, end) > -1).all(axis=1) & (np.minimum(start, end) < size + 1).all(axis=1)
        start, end = start[seen], end[seen]
        steps = np.ceil(np.abs(end - start).max(axis=1) / _STEP_PIXELS).astype(np.int64) + 1
        if int(steps.sum()) > _MAX_POINTS_PER_PIXEL * marked.size:
            return ~marked
        edge = np.repeat(np.arange(len(steps)), steps)
        within = np.arange(len(edge)) - np.repeat(np.cumsum(steps) - steps, steps)
        share = within / np.maximum(steps[edge] - 1, 1)
        points = np.floor(start[edge] + share[:, None] * (end - start)[edge])
        points = points[((points >= -1) & (points <= size)).all(axis=1)].astype(np.int64)
        for x in (-1, 0, 1):
            for y in (-1, 0, 1):
                near = points + np.array([x, y])
                near = near[((near >= 0) & (near < size)).all(axis=1)]
                marked[near[:, 1], near[:, 0]] = True
        return marked
