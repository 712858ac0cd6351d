"""Photographs of a ball: their cameras and masks, their exposures beside other photographs, and the ball itself."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from hir_core.capture import Capture, View
from hir_core.capture.photograph_exposures import recorded_exposure
from hir_core.errors import InputError
from hir_core.intake.mask_sources import apply_mask_sources
from hir_core.intake.reader_lookup import read_capture
from hir_plugins.commands.light_probe.sphere_fit import Sphere, fit_sphere

if TYPE_CHECKING:
    from hir_core.plugins.manager import PluginManager


@dataclass(frozen=True)
class BallPhotographs:
    """A capture of a ball alone."""

    capture: Capture
    """With cameras and masks."""
    ball: Sphere


def read_ball(photos: Path, plugins: PluginManager) -> BallPhotographs:
    """The photographs of a folder; `InputError` where cameras or masks are missing, or masks show no ball."""
    capture = read_capture(photos, "train", plugins)
    if not capture.views or any(view.camera is None for view in capture.views):
        raise InputError(
            f"{photos} has photographs without cameras; export the scanning program's cameras of these photographs, "
            "too (docs/captures.md)"
        )
    capture = apply_mask_sources(capture, None, "auto", {}, plugins, known="photographs")
    capture = apply_mask_sources(capture, None, "auto", {}, plugins, known="cameras")
    outlines = []
    for view in capture.views:
        mask = view.pixels().mask
        assert view.camera is not None
        if mask is None:
            raise InputError(f"{photos}: {view.name} has no mask of the ball; add masks (docs/captures.md#masks)")
        outlines.append((view.camera, mask))
    try:
        return BallPhotographs(capture, fit_sphere(outlines))
    except InputError as error:
        raise InputError(f"{photos}: {error}") from None


def exposed_views(capture: Capture, reference: Capture | None) -> Sequence[View]:
    """The views with their recorded exposures beside the mean of the reference's photographs, or beside their own mean.

    A warning says where exposures are assumed to be equal, because they are not recorded.
    """
    own = _recorded(capture)
    others = own if reference is None else _recorded(reference)
    if own is None or others is None:
        if reference is not None:
            without, other = (capture, reference) if own is None else (reference, capture)
            warnings.warn(
                f"{without.path} records no exposures, so its photographs count as exposed like those of {other.path}: "
                "keep the EXIF data, or scale the light with FILE*STRENGTH",
                stacklevel=2,
            )
        if own is None:
            return capture.views
    middle = _geometric_mean(own if others is None else others)
    return [replace(v, exposure=v.exposure * each / middle) for v, each in zip(capture.views, own, strict=True)]


def _recorded(capture: Capture) -> list[float] | None:
    """The exposure of each view; None where none is recorded, `InputError` where some are."""
    found = [recorded_exposure(view) for view in capture.views]
    known = [each for each in found if each is not None]
    if known and len(known) < len(found):
        name = next(view.name for view, each in zip(capture.views, found, strict=True) if each is None)
        raise InputError(f"{capture.path}: {name} records no exposure, others do; keep the EXIF data of all")
    return known or None


def _geometric_mean(values: Sequence[float]) -> float:
    return math.exp(sum(map(math.log, values)) / len(values))
