"""A volume with an opening sunk into it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates

from hir_core.capture import Array
from hir_plugins.initializers.hollows.openings import Flags, Opening
from hir_plugins.initializers.surface.volume import Volume

WALL = 2.0
"""Least thickness of what stays, in voxels of the search."""

WALL_SAMPLES = 1.5
"""The same in voxels of the volume that is carved, if they are larger: a thinner wall has holes."""

IN_FRONT = 4.0
"""Voxels of the search in front of an opening's plane that its columns carve; what is farther ahead stays."""

BESIDE = 3
"""Voxels of the search around the columns in which the signed distance becomes that of their wall."""

NARROW = 8.0
"""Width in voxels of the search of gaps in a hull from which the wall of a hollow keeps no distance."""


@dataclass(frozen=True)
class Solid:
    """A volume before its first hollow."""

    inside: Flags
    """(X, Y, Z)."""
    without_gaps: Flags
    """(X, Y, Z): with gaps narrower than `NARROW` filled. The hull of a hole is a narrower hole."""

    @classmethod
    def of(cls, inside: Flags) -> Solid:
        """Fills the gaps by a dilation and an erosion."""
        radius = NARROW / 2
        margin = int(radius) + 1
        dilated = distance_transform_edt(~np.pad(inside, margin)) <= radius
        closed = distance_transform_edt(dilated) > radius
        return cls(inside, np.asarray(closed[(slice(margin, -margin),) * 3]))


def wall_distance(solid: Solid, opening: Opening) -> Array:
    """Distance in voxels from each voxel to the outside, where the opening is closed: what its columns have in front of
    them counts as inside, and so do narrow gaps in them.
    """
    closed = solid.inside.copy()
    outside = np.argwhere(~closed)
    outside = outside[opening.contains(outside)]
    front = outside @ opening.normal > opening.level - 2
    closed[tuple(outside[front | solid.without_gaps[tuple(outside.T)]].T)] = True
    return np.asarray(distance_transform_edt(np.pad(closed, 1))[1:-1, 1:-1, 1:-1])


def reach(inside: Flags, opening: Opening) -> float:
    """Of the opening's columns into the volume, in voxels."""
    cells = np.argwhere(inside)
    cells = cells[opening.contains(cells)]
    return max(0.0, opening.level - float((cells @ opening.normal).min())) if len(cells) else 0.0


def sunk(volume: Volume, search: Volume, opening: Opening, depth: float, wall: Array) -> Volume:
    """The volume without the columns of an opening down to a depth, but for a wall of `WALL` voxels of the search.

    Opening, depth and wall (X, Y, Z) are in voxels of `search`, which `volume` may sample more finely.
    """
    near = np.argwhere(volume.values > -2 * volume.spacing)
    place = (volume.origin + near * volume.spacing - search.origin) / search.spacing
    below = opening.level - place @ opening.normal
    # farther from the columns the signed distance stays as it is: only the sign and the next voxels are used there
    affected = (below >= -IN_FRONT - BESIDE) & opening.grown(BESIDE).contains(place)
    near, place, below = near[affected], place[affected], below[affected]
    at_wall = map_coordinates(wall, place.T, order=1, mode="nearest")
    distance = opening.distance(place)
    least = max(WALL, WALL_SAMPLES * volume.spacing / search.spacing)
    inside = np.minimum(np.minimum(distance, depth * opening.floor(distance) - below), at_wall - least)
    inside = np.where(below < -IN_FRONT, -1.0, inside)
    carved = (-inside * search.spacing).astype(np.float32)
    values = volume.values.copy()
    values[tuple(near.T)] = np.minimum(values[tuple(near.T)], carved)
    return replace(volume, values=values)
