"""Which openings are sunk where material and light are known: what renders most like the photographs decides."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

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
from hir_plugins.initializers.hollows.photo_prediction import BlurredPhotograph
from hir_plugins.initializers.hollows.rendered_prediction import Appearance, squared_errors
from hir_plugins.initializers.hollows.sunk_volume import Solid, sunk, wall_distance
from hir_plugins.initializers.hollows.windows import Floats, window_of
from hir_plugins.initializers.surface.volume import Volume

SAMPLES, SAMPLES_OF_ALL = 16, 4
"""Paths for each pixel of a window, and for each pixel of the object where openings are looked for."""

Pictures = Callable[[int], Sequence[NDArray[np.float32]]]
"""From paths for each pixel: the fitted mesh with all its maps as each photograph shows it."""

LEAST_REDUCTION, PROMISING = 0.5, 0.25
"""Share of the error of the surface before it that a hollow must save, and from which its outline is refined."""

WELL_EXPLAINED = 0.95
"""Share of the variance of its pixels from which an opening needs no hollow: 0.99 of a dark spot on plaster, 0.92 to
0.94 of the lid of a silver vase, the most of a true hollow on the tuning half (docs/studies/hollows.md)."""

OUTLINE_DETAILS = (3.0, 4.5, 6.0)
"""Of smoother outlines that are tried, in voxels."""

DEPTH_FACTORS = (1.15, 1.05)
"""By which the depth is moved at last, coarse steps first."""

CONFIDENCE = 0.95
"""That a hollow saves anything, by Student's t over photographs."""

REFINED = 3
"""Openings whose outline is refined, those that save most first."""

LEAST_VIEWS_OF_CELL = 4
"""Photographs that must see a cell of the surface for an opening to hold it."""

LIFT = 1.8
"""In voxels, at which rays to the cameras leave the surface."""


@dataclass(frozen=True)
class RenderedHollow:
    """An opening, how deep it is sunk, and what that saves."""

    opening: Opening
    depth: float
    """In voxels of the search."""
    wall: Floats
    """Distance to the outside (X, Y, Z), the opening closed."""
    explained_before: float
    """Share of the variance of the pixels that look into the opening, rendered with the surface before it."""
    explained: float
    """With the hollow."""
    reduction: float
    """Share of the error of the surface before it that the hollow saves."""
    gain: float
    """Mean over photographs of what the logarithm of the error falls by, in standard errors."""
    explained_repainted: float
    """With the hollow, where its inside and what is around it have the colours that suit best."""
    explained_by_maps: float
    """By the fitted mesh with all its maps."""
    views: int
    """Photographs that look in."""

    @property
    def is_confirmed(self) -> bool:
        """Whether it saves enough and not by noise, explains more than one colour for each photograph would, and the
        maps of the fitted mesh do not explain its pixels well, as they explain a dark spot.
        """
        return (
            self.reduction >= LEAST_REDUCTION
            and self.explained_repainted >= 0
            and self.gain >= least_gain(self.views, CONFIDENCE)
            and self.explained_by_maps < WELL_EXPLAINED
        )


def find_rendered_hollows(
    volume: Volume, photographs: Sequence[BlurredPhotograph], appearance: Appearance, seed: int, most: int
) -> list[RenderedHollow]:
    """At most `most` hollows, each of the volume with those before it; none of an object thinner than a voxel."""
    if not (volume.values > 0).any():
        return []
    solid = Solid.of(volume.values > 0)
    pictures = cache(lambda samples: appearance.fitted_pictures(photographs, samples, seed))
    found: list[RenderedHollow] = []
    while len(found) < most:
        hollow = _find_hollow(volume, solid, photographs, appearance, seed, pictures)
        if hollow is None:
            break
        found.append(hollow)
        volume = sunk(volume, volume, hollow.opening, hollow.depth, hollow.wall)
    return found


@dataclass(frozen=True)
class _RenderedSearch(OutlineSearch):
    """Pixels are predicted by path tracing."""

    photographs: Sequence[BlurredPhotograph]
    appearance: Appearance
    seed: int
    pictures: Pictures

    def errors(self, volume: Volume) -> Floats:
        """Of the volume with the fitted material and light."""
        return self._errors(volume)

    def _errors(self, volume: Volume, repainted: Mapping[int, NDArray[np.bool_]] | None = None) -> Floats:
        pixels = self.window.pixels
        radiance = self.appearance.radiance(smooth_triangles(volume), self.photographs, pixels, SAMPLES, self.seed)
        return self.window.means(squared_errors(radiance, self.photographs, pixels, repainted))

    def refined(self, found: Sunk, steps: Sequence[int]) -> Sunk:
        """Also with smoother outlines, and with the whole outline and the depth moved as long as the error falls: what
        walls reflect depends on their normals, and a voxel more or less shows.
        """
        found = super().refined(found, steps)
        for detail in OUTLINE_DETAILS:
            opening = found.opening.smoothed(detail)
            if opening.region.any():
                found = _better(found, self.best(opening, self.depths(opening)))
        for factor in DEPTH_FACTORS:
            while True:
                before, sectors = found, found.opening.sectors(1)
                for step in (1, -1):
                    opening = before.opening.moved(sectors, [0], step)
                    if opening.region.any():
                        found = _better(found, self.sunk(opening, before.depth))
                for depth in (before.depth * factor, before.depth / factor):
                    found = _better(found, self.sunk(before.opening, depth))
                if found is before:
                    break
        return found

    def with_errors_before(self) -> _RenderedSearch:
        """The search with the errors of the volume as it is."""
        return replace(self, before=self.errors(self.volume))

    def hollow(self, found: Sunk) -> RenderedHollow:
        """With all that decides whether it is one."""
        inside = self._pixels_inside(found.opening)
        repainted = self._errors(self.sunk_volume(found.opening, found.depth), inside)
        return RenderedHollow(
            found.opening,
            found.depth,
            self.wall,
            self.window.explained(self.before),
            self.explained(found),
            self.reduction(found),
            _gain(self.before, found.errors),
            self.window.explained(repainted),
            self.explained_by_maps(),
            len(self.before),
        )

    def explained_by_maps(self, samples: int = SAMPLES) -> float:
        """Share of the variance of the pixels that the fitted mesh explains with all its maps, rendered with so many
        paths for each pixel.
        """
        pictures = self.pictures(samples)
        errors = {
            i: ((pictures[i] - self.photographs[i].colors)[chosen[:, 1], chosen[:, 0]] ** 2).sum(axis=1)
            for i, chosen in self.window.pixels.items()
        }
        return self.window.explained(self.window.means(errors))

    def _pixels_inside(self, opening: Opening) -> dict[int, NDArray[np.bool_]]:
        """Whether each pixel of the window looks into an opening, and not at what is around it."""
        inside = {}
        for i, chosen in self.window.pixels.items():
            origins, directions = self.photographs[i].camera.rays(chosen + 0.5)
            start = (origins - self.volume.origin) / self.volume.spacing
            along = (opening.level - start @ opening.normal) / (directions @ opening.normal)
            inside[i] = opening.contains(start + directions * along[:, None])
        return inside

    def reduction(self, found: Sunk) -> float:
        """Share of the error of the volume as it is that a hollow saves."""
        return self.saved(found) / max(float(self.before.mean()), 1e-12)


def _find_hollow(
    volume: Volume,
    solid: Solid,
    photographs: Sequence[BlurredPhotograph],
    appearance: Appearance,
    seed: int,
    pictures: Pictures,
) -> RenderedHollow | None:
    """The hollow that saves most; None where no candidate saves enough.

    Openings that the fitted maps explain well are not sunk. A few paths show it: noise lowers the share.
    """
    cells = surface_cells(volume.values > 0)
    error, count = _errors_of_cells(volume, cells, photographs, appearance, seed)

    def without_errors(opening: Opening) -> _RenderedSearch | None:
        """None where too few photographs look in."""
        window = window_of(volume, opening, photographs, seed)
        if window is None:
            return None
        wall = wall_distance(solid, opening.grown(max(FIRST_STEPS)))
        return _RenderedSearch(volume, window, np.zeros(0), wall, photographs, appearance, seed, pictures)

    def search_of(opening: Opening) -> _RenderedSearch | None:
        search = without_errors(opening)
        return None if search is None else search.with_errors_before()

    searches = []
    for opening in find_openings(volume, cells, error, count >= LEAST_VIEWS_OF_CELL)[:CANDIDATES]:
        search = without_errors(opening)
        if search is not None and search.explained_by_maps(SAMPLES_OF_ALL) < WELL_EXPLAINED:
            search = search.with_errors_before()
            sunk_once = search.best(opening, search.depths(opening)[-1::-2])
            searches.append((search.saved(sunk_once) * int(opening.region.sum()), search, sunk_once))
    rejected: list[Opening] = []
    for _, search, sunk_once in sorted(searches, key=lambda each: -each[0]):
        if len(rejected) == REFINED:
            break
        if search.reduction(sunk_once) < PROMISING or search.explained_by_maps() >= WELL_EXPLAINED:
            continue
        if any(is_nearly(sunk_once.opening, each) for each in rejected):
            continue
        search, found = refined_twice(search, sunk_once, search_of)
        hollow = search.hollow(found)
        if hollow.is_confirmed:
            return hollow
        rejected.append(hollow.opening)
    return None


def _better(found: Sunk, other: Sunk) -> Sunk:
    return other if other.errors.mean() < found.errors.mean() else found


def _gain(before: Floats, after: Floats) -> float:
    """Of logarithms, so that a photograph with a light in it does not decide alone."""
    return gain_in_standard_errors(*(np.log(np.maximum(errors, 1e-12)) for errors in (before, after)))


def _errors_of_cells(
    volume: Volume,
    cells: np.ndarray,
    photographs: Sequence[BlurredPhotograph],
    appearance: Appearance,
    seed: int,
) -> tuple[Floats, np.ndarray]:
    """Mean squared error of each cell (N, 3) of the surface, and how many photographs see it."""
    triangles = smooth_triangles(volume)
    surface = MeshQueries(*triangles)
    pixels = {i: np.argwhere(photograph.valid)[:, ::-1] for i, photograph in enumerate(photographs)}
    pixels = {i: chosen for i, chosen in pixels.items() if len(chosen)}
    radiance = appearance.radiance(triangles, photographs, pixels, SAMPLES_OF_ALL, seed)
    errors = squared_errors(radiance, photographs, pixels)
    points = volume.origin + cells * volume.spacing
    total, count = np.zeros(len(cells)), np.zeros(len(cells), np.int64)
    for i, chosen in pixels.items():
        image = np.zeros((*photographs[i].valid.shape, 1), np.float32)
        image[chosen[:, 1], chosen[:, 0], 0] = errors[i]
        index, seen = replace(photographs[i], colors=image).seen(points, surface, LIFT * volume.spacing)
        total[index] += seen[:, 0]
        count[index] += 1
    return total / np.maximum(count, 1), count
