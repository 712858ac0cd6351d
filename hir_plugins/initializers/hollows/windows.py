"""The pixels of photographs that look into an opening, and the share of their variance that something explains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hir_plugins.initializers.hollows.openings import Opening
from hir_plugins.initializers.hollows.photo_prediction import BlurredPhotograph, Pixels
from hir_plugins.initializers.surface.volume import Volume

LEAST_VIEWS, LEAST_PIXELS, MOST_PIXELS = 6, 12, 80
"""Photographs that look into an opening; pixels of each."""

MOST_UNKNOWN = 0.25
"""Share of a photograph's pixels that need no prediction: few others look at the floor of a deep well."""

WINDOW_MARGIN = 3
"""Voxels around an opening whose pixels are looked at, too."""

Floats = NDArray[np.floating]


@dataclass(frozen=True)
class Window:
    """The pixels that look into an opening."""

    pixels: Mapping[int, Pixels]
    """Of each photograph that looks in, by its index."""
    deviations: Mapping[int, Floats]
    """Squared deviation of each pixel from the mean of its photograph's."""

    @property
    def variance(self) -> float:
        """Mean over photographs."""
        return float(np.mean([values.mean() for values in self.deviations.values()]))

    def means(self, errors: Mapping[int, Floats]) -> Floats:
        """Mean error of the pixels of each photograph (V,). Those that nothing predicts do not count, but for more than
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

    def explained(self, errors: Floats) -> float:
        """Share of the variance of the pixels that predictions with these mean errors (V,) explain."""
        return 1 - float(errors.mean()) / max(self.variance, 1e-12)


def window_of(volume: Volume, opening: Opening, photographs: Sequence[BlurredPhotograph], seed: int) -> Window | None:
    """The pixels that look into an opening and `WINDOW_MARGIN` around it; None where too few photographs look in."""
    opening = opening.grown(WINDOW_MARGIN)
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
    return Window(pixels, deviations) if len(pixels) >= LEAST_VIEWS else None
