"""Depths and outlines of one opening: those are kept that leave the least error in the photographs that look in."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.special import stdtrit

from hir_plugins.initializers.hollows.openings import Opening
from hir_plugins.initializers.hollows.sunk_volume import reach, sunk
from hir_plugins.initializers.hollows.windows import Floats, Window
from hir_plugins.initializers.surface.isosurface import extract_surface
from hir_plugins.initializers.surface.volume import Volume

CANDIDATES, DEPTHS = 12, 9
"""Openings that are tried, and depths of each."""

SAME_PLANE, SAME_LEVEL, COVERED = 0.9, 4.0, 0.7
"""Cosine between normals, voxels between planes and share of the cells, from which two openings are nearly the same."""

SECTORS = 12
FIRST_STEPS, STEPS = (4, -2), (4, 2, -2, 1, -1)
"""Of a first outline in each sector, in voxels, one after the other; and of the one that is found with them."""

ROUNDINGS = (0.5, 1.0)
"""Of floors that are tried."""

NEAR_DEPTHS = (0.8, 0.87, 0.93, 1.0, 1.07, 1.15, 1.25, 1.4)
"""That are tried for a rounded hollow, as shares of the depth that was found before."""

SMOOTH_OUTLINES = (3.0, 4.5)
"""In voxels: outlines without finer detail that are tried."""

OUTLINE_DETAIL = 1.5
"""Of a refined outline, in voxels: sectors that move by themselves leave steps."""

SAME_SHARE = 0.01
"""Share of the explained error by which another depth may be worse and counts as equal."""


SearchT = TypeVar("SearchT", bound="OutlineSearch")


@dataclass(frozen=True)
class Sunk:
    """An opening at a depth, and what is left of the errors (V,) of the photographs that look in."""

    opening: Opening
    depth: float
    """In voxels."""
    errors: Floats


@dataclass(frozen=True)
class OutlineSearch(ABC):
    """Depths and outlines of one opening of a volume."""

    volume: Volume
    window: Window
    before: Floats
    """Errors (V,) of the volume as it is."""
    wall: Floats
    """Distance to the outside (X, Y, Z), the opening closed."""

    @abstractmethod
    def errors(self, volume: Volume) -> Floats:
        """Mean squared error (V,) of the pixels of each photograph of the window, where the object is this volume."""

    def depths(self, opening: Opening) -> list[float]:
        """To try, in voxels, from shallow to as deep as the volume is."""
        deepest = max(reach(self.volume.values > 0, opening), 3.0)
        return [float(depth) for depth in np.unique(np.round(np.geomspace(3, deepest, DEPTHS)))]

    def sunk_volume(self, opening: Opening, depth: float) -> Volume:
        """The volume with this opening at a depth."""
        return sunk(self.volume, self.volume, opening, depth, self.wall)

    def sunk(self, opening: Opening, depth: float) -> Sunk:
        """What is left at a depth."""
        return Sunk(opening, depth, self.errors(self.sunk_volume(opening, depth)))

    def best(self, opening: Opening, depths: Sequence[float]) -> Sunk:
        """At the deepest of the depths that explain the photographs as well as the best one: what no photograph sees is
        hollow down to the wall.
        """
        tried = [self.sunk(opening, depth) for depth in depths]
        best = min(tried, key=lambda each: each.errors.mean())
        return max((each for each in tried if self.is_as_good(each, best)), key=lambda each: each.depth)

    def refined(self, found: Sunk, steps: Sequence[int]) -> Sunk:
        """With an outline that is moved sector by sector, and the depth of that."""
        opening = self.outlined(found, steps)
        return self.best(opening, self.depths(opening))

    def outlined(self, found: Sunk, steps: Sequence[int]) -> Opening:
        """The opening with an outline that is moved sector by sector."""
        sectors = found.opening.sectors(SECTORS)
        for step in steps:
            for sector in range(SECTORS):
                moved = self.sunk(found.opening.moved(sectors, [sector], step), found.depth)
                if moved.errors.mean() < found.errors.mean():
                    found = moved
        smooth = found.opening.smoothed(OUTLINE_DETAIL)
        return smooth if smooth.region.any() else found.opening

    def shaped(self, found: Sunk) -> Sunk:
        """With a floor that rises towards the outline, where that explains more than noise, and with a smoother outline
        that explains no less.

        As many photographs see a rounded floor as its wall: it has the best depth, not the deepest of equal ones.
        """
        for rounding in ROUNDINGS:
            rounded = self.best_near(replace(found.opening, rounding=rounding), found.depth)
            rounded = self.best_near(self.outlined(rounded, STEPS), rounded.depth)
            if not self.is_as_good(found, rounded):
                found = rounded
        for detail in SMOOTH_OUTLINES:
            opening = found.opening.smoothed(detail)
            if opening.region.any():
                found = min(found, self.sunk(opening, found.depth), key=lambda each: each.errors.mean())
        return found

    def best_near(self, opening: Opening, depth: float) -> Sunk:
        """At the depth near this one that explains most."""
        tried = (self.sunk(opening, round(factor * depth, 1)) for factor in NEAR_DEPTHS)
        return min(tried, key=lambda each: each.errors.mean())

    def is_as_good(self, found: Sunk, best: Sunk) -> bool:
        """Whether it leaves no more than another one, or more by noise alone."""
        worse = found.errors - best.errors
        noise = float(worse.std(ddof=1)) / len(worse) ** 0.5
        return bool(worse.mean() <= max(noise, SAME_SHARE * self.saved(best)))

    def saved(self, found: Sunk) -> float:
        """Mean squared error that a hollow explains."""
        return float((self.before - found.errors).mean())

    def explained(self, found: Sunk) -> float:
        """Share of the variance of the pixels."""
        return self.window.explained(found.errors)


def refined_twice(search: SearchT, first: Sunk, search_of: Callable[[Opening], SearchT | None]) -> tuple[SearchT, Sunk]:
    """The refined outline of an opening, and the search in whose window it was found: that of a first outline which was
    too small does not show how much larger it is. `search_of` makes one; None where too few photographs look in.
    """
    found = search.refined(first, FIRST_STEPS)
    wider = search_of(found.opening)
    if wider is None:
        return search, found
    return wider, wider.refined(wider.sunk(found.opening, found.depth), STEPS)


def smooth_triangles(volume: Volume) -> tuple[Floats, np.ndarray]:
    """Vertices (V, 3) and faces (F, 3) for rays; the steps of voxels are smoothed away, where that leaves anything."""
    inside = np.clip(volume.values / volume.spacing, -2, 2)
    smoothed = gaussian_filter(inside, 0.7)
    values = (smoothed if smoothed.max() > 0.02 else inside) * volume.spacing
    return extract_surface(Volume(values, volume.origin, volume.spacing))


def gain_in_standard_errors(before: Floats, after: Floats) -> float:
    """Mean of what was saved of the errors (V,), in standard errors over photographs."""
    saved = before - after
    return float(saved.mean()) / max(float(saved.std(ddof=1)) / len(saved) ** 0.5, 1e-12)


def least_gain(views: int, confidence: float) -> float:
    """Standard errors from which a gain over so many photographs is no noise, by Student's t."""
    return float(stdtrit(views - 1, (1 + confidence) / 2))


def is_nearly(opening: Opening, other: Opening) -> bool:
    """Whether an opening lies in the plane of another one and has nearly its region, as a hole in a face has not."""
    if opening.normal @ other.normal < SAME_PLANE or opening.region.sum() < COVERED * other.region.sum():
        return False
    centers = opening.cell_centers()
    near = np.abs(centers @ other.normal - other.level) <= SAME_LEVEL
    return float((near & other.contains(centers)).mean()) >= COVERED
