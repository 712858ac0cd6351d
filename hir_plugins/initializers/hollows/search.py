"""Which openings of a volume are sunk, and how deep: what explains the photographs best decides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hir_core.mesh.ray_casting import MeshQueries
from hir_plugins.initializers.hollows.openings import Opening, find_openings, surface_cells
from hir_plugins.initializers.hollows.outline_search import (
    CANDIDATES,
    FIRST_STEPS,
    OutlineSearch,
    Sunk,
    gain_in_standard_errors,
    is_nearly,
    least_gain,
    refined_twice,
    smooth_triangles,
)
from hir_plugins.initializers.hollows.photo_prediction import (
    BlurredPhotograph,
    PredictedPixels,
    color_variance,
)
from hir_plugins.initializers.hollows.reflection import reflection_errors
from hir_plugins.initializers.hollows.sunk_volume import Solid, sunk, wall_distance
from hir_plugins.initializers.hollows.windows import Floats, window_of
from hir_plugins.initializers.surface.volume import Volume

HALF_OF_VARIANCE = 0.5
"""Share of the variance of an opening's pixels that a hollow must explain, as view independence asks of stereo."""

PROMISING = 0.25
"""That share, before the outline is refined, from which it is."""

NEARLY_HALF = 0.4
"""That share, after it is refined, from which its floor is shaped, too."""

DISTANT_DEGREES, THIRD_OF_VARIANCE = 35.0, 1 / 3
"""Photographs that are this far apart must explain that share: reflections, too, agree between near ones."""

LEAST_DEPTH = 0.45
"""Of a hollow, as a share of its width (the square root of its area): flatter ones must explain `WELL_EXPLAINED`."""

WELL_EXPLAINED = 2 / 3, 0.6
"""Shares of the variance that a flat hollow must explain, by all photographs and by distant ones. The curved surface
of a metal looks a little like one: 0.64 and 0.52 on the tuning half."""

CONFIDENCE = 0.95
"""That a hollow explains more than the surface before it, by Student's t over photographs."""

HALF_OF_REST = 0.5
"""Share that a hollow must explain of the variance that the surface before it, or its reflections, leave."""

LIFT = 1.0
"""In voxels, at which rays to the cameras leave the surface."""


@dataclass(frozen=True)
class Hollow:
    """An opening, how deep it is sunk, and what that explains."""

    opening: Opening
    depth: float
    """In voxels of the search."""
    wall: Floats
    """Distance to the outside (X, Y, Z), the opening closed."""
    explained_before: float
    explained_by_reflection: float
    """By the surface before it, if it is a mirror or a rough metal."""
    explained: float
    """Share of the variance of the pixels that look into the opening, by all photographs."""
    explained_from_far: float
    """By those `DISTANT_DEGREES` apart or more."""
    gain: float
    """In standard errors over photographs."""
    views: int
    """Photographs that look in."""

    @property
    def is_confirmed(self) -> bool:
        """Whether it explains enough, from near and far and of what was left, more so where it is flat, and its gain is
        no noise."""
        deep = self.depth >= LEAST_DEPTH * float(self.opening.region.sum()) ** 0.5
        least, least_from_far = (HALF_OF_VARIANCE, THIRD_OF_VARIANCE) if deep else WELL_EXPLAINED
        otherwise = max(self.explained_before, self.explained_by_reflection)
        return (
            self.explained >= least
            and self.explained_from_far >= least_from_far
            and self.explained - otherwise >= HALF_OF_REST * (1 - otherwise)
            and self.gain >= least_gain(self.views, CONFIDENCE)
        )


def find_hollows(volume: Volume, photographs: Sequence[BlurredPhotograph], seed: int, most: int) -> list[Hollow]:
    """At most `most` hollows, each of the volume with those before it.

    None of an object that is thinner than a voxel. Walls are measured in the volume before the first hollow, so two
    hollows that meet are a hole.
    """
    if not (volume.values > 0).any():
        return []
    solid = Solid.of(volume.values > 0)
    found: list[Hollow] = []
    while len(found) < most:
        hollow = _find_hollow(volume, solid, photographs, seed)
        if hollow is None:
            break
        found.append(hollow)
        volume = sunk(volume, volume, hollow.opening, hollow.depth, hollow.wall)
    return found


def _find_hollow(volume: Volume, solid: Solid, photographs: Sequence[BlurredPhotograph], seed: int) -> Hollow | None:
    """The hollow that explains most; None where no candidate explains enough."""
    surface = MeshQueries(*smooth_triangles(volume))
    cells = surface_cells(volume.values > 0)
    variance, count = color_variance(volume.origin + cells * volume.spacing, surface, photographs, 1.8 * volume.spacing)

    def search_of(opening: Opening) -> _PhotographSearch | None:
        """None where too few photographs look in."""
        window = window_of(volume, opening, photographs, seed)
        if window is None:
            return None
        predicted = PredictedPixels.of(window.pixels, photographs)
        before = window.means(predicted.errors(surface, LIFT * volume.spacing))
        wall = wall_distance(solid, opening.grown(max(FIRST_STEPS)))
        return _PhotographSearch(volume, window, before, wall, surface, predicted)

    searches = []
    for opening in find_openings(volume, cells, variance, count >= 4)[:CANDIDATES]:
        search = search_of(opening)
        if search is not None:
            sunk_once = search.best(opening, search.depths(opening)[-1::-2])
            searches.append((search.saved(sunk_once) * int(opening.region.sum()), search, sunk_once))
    rejected: list[Opening] = []
    for saved, search, sunk_once in sorted(searches, key=lambda each: -each[0]):
        if saved <= 0 or search.explained(sunk_once) < PROMISING:
            continue
        if any(is_nearly(sunk_once.opening, other) for other in rejected):
            continue
        search, found = refined_twice(search, sunk_once, search_of)
        if search.explained(found) >= NEARLY_HALF:
            found = search.shaped(found)
        hollow = search.hollow(found)
        if hollow.is_confirmed:
            return hollow
        rejected.append(hollow.opening)
    return None


@dataclass(frozen=True)
class _PhotographSearch(OutlineSearch):
    """Pixels are predicted by what other photographs show at the same points."""

    surface: MeshQueries
    """Of the volume as it is."""
    predicted: PredictedPixels
    """Those of the window."""

    def errors(self, volume: Volume) -> Floats:
        """Of predictions by all other photographs of the take."""
        return self._errors(volume)

    def _errors(self, volume: Volume, least_degrees: float = 0.0) -> Floats:
        surface = MeshQueries(*smooth_triangles(volume))
        return self.window.means(self.predicted.errors(surface, LIFT * self.volume.spacing, least_degrees))

    def hollow(self, found: Sunk) -> Hollow:
        """With all that decides whether it is one."""
        far = self._errors(self.sunk_volume(found.opening, found.depth), DISTANT_DEGREES)
        reflected = reflection_errors(self.window.pixels, self.volume, self.surface, self.predicted.photographs)
        return Hollow(
            found.opening,
            found.depth,
            self.wall,
            self.window.explained(self.before),
            self.window.explained(self.window.means(reflected)),
            self.explained(found),
            self.window.explained(far),
            gain_in_standard_errors(self.before, found.errors),
            len(self.before),
        )
