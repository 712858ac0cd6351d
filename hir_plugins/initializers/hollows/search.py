"""Which openings of a volume are sunk, and how deep: what explains the photographs best decides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.special import stdtrit

from hir_core.mesh.ray_casting import MeshQueries
from hir_plugins.initializers.hollows.openings import Opening, find_openings, surface_cells
from hir_plugins.initializers.hollows.photo_prediction import (
    BlurredPhotograph,
    Pixels,
    color_variance,
    prediction_errors,
)
from hir_plugins.initializers.hollows.reflection import reflection_errors
from hir_plugins.initializers.hollows.sunk_volume import Solid, reach, sunk, wall_distance
from hir_plugins.initializers.surface.isosurface import extract_surface
from hir_plugins.initializers.surface.volume import Volume

HALF_OF_VARIANCE = 0.5
"""Share of the variance of an opening's pixels that a hollow must explain, as view independence asks of stereo."""

PROMISING = 0.25
"""That share, before the outline is refined, from which it is."""

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

LEAST_VIEWS, LEAST_PIXELS, MOST_PIXELS = 6, 12, 80
"""Photographs that look into an opening; pixels of each."""

MOST_UNKNOWN = 0.25
"""Share of a photograph's pixels that no other photograph need predict: few look at the floor of a deep well."""

CANDIDATES, DEPTHS = 12, 9
"""Openings that are tried, and depths of each."""

SAME_PLANE, SAME_LEVEL, COVERED = 0.9, 4.0, 0.7
"""Cosine between normals, voxels between planes and share of the cells, from which two openings are nearly the same."""

WINDOW_MARGIN = 3
"""Voxels around an opening whose pixels are looked at, too."""

SECTORS = 12
FIRST_STEPS, STEPS = (4, -2), (4, 2, -2, 1, -1)
"""Of a first outline in each sector, in voxels, one after the other; and of the one that is found with them."""

OUTLINE_DETAIL = 1.5
"""Of a refined outline, in voxels: sectors that move by themselves leave steps."""

SAME_SHARE = 0.01
"""Share of the explained error by which another depth may be worse and counts as equal."""

LIFT = 1.0
"""In voxels, at which rays to the cameras leave the surface."""

Floats = NDArray[np.floating]


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
            and self.gain >= float(stdtrit(self.views - 1, (1 + CONFIDENCE) / 2))
        )


@dataclass(frozen=True)
class _Window:
    """The pixels that look into an opening."""

    pixels: dict[int, Pixels]
    deviations: dict[int, Floats]
    """Squared deviation of each pixel from the mean of its photograph's."""

    @property
    def variance(self) -> float:
        """Mean over photographs."""
        return float(np.mean([values.mean() for values in self.deviations.values()]))

    def errors(
        self, surface: MeshQueries, photographs: Sequence[BlurredPhotograph], lift: float, least_degrees: float = 0.0
    ) -> Floats:
        """Mean squared error (V,) of each photograph's pixels, predicted by what others show at the same points."""
        return self._means(prediction_errors(self.pixels, surface, photographs, lift, least_degrees))

    def errors_of_reflections(
        self, volume: Volume, surface: MeshQueries, photographs: Sequence[BlurredPhotograph]
    ) -> Floats:
        """The same, predicted by what others show in the same mirror directions."""
        return self._means(reflection_errors(self.pixels, volume, surface, photographs))

    def _means(self, errors: Mapping[int, Floats]) -> Floats:
        """Of the pixels of each photograph (V,). Those that nothing predicts do not count, but for more than
        `MOST_UNKNOWN` of a photograph, which count as unexplained.
        """
        means = []
        for i, error in errors.items():
            unknown = float(np.isnan(error).mean())
            excess = max(0.0, unknown - MOST_UNKNOWN)
            known = error[~np.isnan(error)]
            least = float(self.deviations[i].mean())
            means.append((1 - excess) * float(known.mean()) + excess * least if len(known) else least)
        return np.array(means)


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
    surface = smooth_surface(volume)
    cells = surface_cells(volume.values > 0)
    variance, count = color_variance(volume.origin + cells * volume.spacing, surface, photographs, 1.8 * volume.spacing)

    def search_of(opening: Opening) -> _Search | None:
        """None where too few photographs look in."""
        window = _window(volume, opening.grown(WINDOW_MARGIN), photographs, seed)
        if window is None:
            return None
        before = window.errors(surface, photographs, LIFT * volume.spacing)
        wall = wall_distance(solid, opening.grown(max(FIRST_STEPS)))
        return _Search(volume, surface, photographs, window, before, wall)

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
        if any(_is_nearly(sunk_once.opening, other) for other in rejected):
            continue
        found = search.refined(sunk_once, FIRST_STEPS)
        # the window of a first outline that was too small does not show how much larger it is
        wider = search_of(found.opening)
        if wider is not None:
            search, found = wider, wider.refined(wider.sunk(found.opening, found.depth), STEPS)
        hollow = search.hollow(found)
        if hollow.is_confirmed:
            return hollow
        rejected.append(hollow.opening)
    return None


def _is_nearly(opening: Opening, other: Opening) -> bool:
    """Whether an opening lies in the plane of another one and has nearly its region, as a hole in a face has not."""
    if opening.normal @ other.normal < SAME_PLANE or opening.region.sum() < COVERED * other.region.sum():
        return False
    centers = opening.cell_centers()
    near = np.abs(centers @ other.normal - other.level) <= SAME_LEVEL
    return float((near & other.contains(centers)).mean()) >= COVERED


def smooth_surface(volume: Volume) -> MeshQueries:
    """For rays; the steps of voxels are smoothed away, where that leaves anything."""
    inside = np.clip(volume.values / volume.spacing, -2, 2)
    smoothed = gaussian_filter(inside, 0.7)
    values = (smoothed if smoothed.max() > 0.02 else inside) * volume.spacing
    return MeshQueries(*extract_surface(Volume(values, volume.origin, volume.spacing)))


def _window(volume: Volume, opening: Opening, photographs: Sequence[BlurredPhotograph], seed: int) -> _Window | None:
    """None where too few photographs look in."""
    points = volume.origin + opening.cell_centers() * volume.spacing
    rng = np.random.default_rng(seed)
    pixels, deviations = {}, {}
    for i, photograph in enumerate(photographs):
        if (photograph.camera.center - points.mean(axis=0)) @ opening.normal <= 0:
            continue
        column, row, inside = photograph.pixels_of(points)
        chosen = np.unique(np.stack([column[inside], row[inside]], axis=1), axis=0)
        chosen = chosen[photograph.valid[chosen[:, 1], chosen[:, 0]]]
        if len(chosen) < LEAST_PIXELS:
            continue
        if len(chosen) > MOST_PIXELS:
            chosen = chosen[rng.choice(len(chosen), MOST_PIXELS, replace=False)]
        colors = photograph.colors[chosen[:, 1], chosen[:, 0]].astype(np.float64)
        pixels[i], deviations[i] = chosen, ((colors - colors.mean(axis=0)) ** 2).sum(axis=1)
    return _Window(pixels, deviations) if len(pixels) >= LEAST_VIEWS else None


@dataclass(frozen=True)
class _Sunk:
    """An opening at a depth, and what is left of the errors (V,) of the photographs that look in."""

    opening: Opening
    depth: float
    errors: Floats


@dataclass(frozen=True)
class _Search:
    """Depths and outlines of one opening."""

    volume: Volume
    surface: MeshQueries
    photographs: Sequence[BlurredPhotograph]
    window: _Window
    before: Floats
    """Errors (V,) of the volume as it is."""
    wall: Floats
    """Distance to the outside (X, Y, Z), the opening closed."""

    def depths(self, opening: Opening) -> list[float]:
        """To try, in voxels, from shallow to as deep as the volume is."""
        deepest = max(reach(self.volume.values > 0, opening), 3.0)
        return [float(depth) for depth in np.unique(np.round(np.geomspace(3, deepest, DEPTHS)))]

    def sunk(self, opening: Opening, depth: float, least_degrees: float = 0.0) -> _Sunk:
        surface = smooth_surface(sunk(self.volume, self.volume, opening, depth, self.wall))
        errors = self.window.errors(surface, self.photographs, LIFT * self.volume.spacing, least_degrees)
        return _Sunk(opening, depth, errors)

    def best(self, opening: Opening, depths: Sequence[float]) -> _Sunk:
        """At the deepest of the depths that explain the photographs as well as the best one: what no photograph sees is
        hollow down to the wall.
        """
        tried = [self.sunk(opening, depth) for depth in depths]
        best = min(tried, key=lambda each: each.errors.mean())
        near = []
        for each in tried:
            worse = each.errors - best.errors
            noise = float(worse.std(ddof=1)) / len(worse) ** 0.5
            if worse.mean() <= max(noise, SAME_SHARE * self.saved(best)):
                near.append(each)
        return max(near, key=lambda each: each.depth)

    def refined(self, found: _Sunk, steps: Sequence[int]) -> _Sunk:
        """With an outline that is moved sector by sector, and the depth of that."""
        sectors = found.opening.sectors(SECTORS)
        for step in steps:
            for sector in range(SECTORS):
                moved = self.sunk(found.opening.moved(sectors, [sector], step), found.depth)
                if moved.errors.mean() < found.errors.mean():
                    found = moved
        smooth = found.opening.smoothed(OUTLINE_DETAIL)
        opening = smooth if smooth.region.any() else found.opening
        return self.best(opening, self.depths(opening))

    def saved(self, found: _Sunk) -> float:
        """Mean squared error that a hollow explains."""
        return float((self.before - found.errors).mean())

    def explained(self, found: _Sunk) -> float:
        """Share of the variance of the pixels."""
        return 1 - float(found.errors.mean()) / max(self.window.variance, 1e-12)

    def hollow(self, found: _Sunk) -> Hollow:
        saved = self.before - found.errors
        noise = float(saved.std(ddof=1)) / len(saved) ** 0.5
        far = self.sunk(found.opening, found.depth, DISTANT_DEGREES)
        reflected = self.window.errors_of_reflections(self.volume, self.surface, self.photographs)
        return Hollow(
            found.opening,
            found.depth,
            self.wall,
            self.explained(_Sunk(found.opening, 0.0, self.before)),
            self.explained(_Sunk(found.opening, 0.0, reflected)),
            self.explained(found),
            self.explained(far),
            float(saved.mean()) / max(noise, 1e-12),
            len(saved),
        )
