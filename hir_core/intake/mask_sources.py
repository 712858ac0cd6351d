"""Masks of a capture from the installed mask sources, in their order."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import compress
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from hir_core.capture import Capture
from hir_core.errors import CaptureError, PluginError
from hir_core.plugins.registration import a_value

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import MaskSource
    from hir_core.plugins.manager import PluginManager
    from hir_core.scene import Scene


Known = Literal["photographs", "cameras", "mesh"]
"""What is known when mask sources are called: photographs alone, their cameras too, and the initializers' mesh too."""


def needed_by(traits: Collection[str]) -> Known:
    """What a source with these traits needs."""
    if "needs_mesh" in traits:
        return "mesh"
    return "cameras" if "needs_cameras" in traits else "photographs"


def mask_source_names(masks: Sequence[str] | Literal["auto"], plugins: PluginManager) -> list[str]:
    """The sources that the setting `masks` names; for `auto`, the installed ones with the trait `automatic`."""
    if masks != "auto":
        return list(masks)
    installed = plugins.components("mask_source")
    return [r.component.name for r in installed if "automatic" in r.component.traits and not r.missing]


def apply_mask_sources(
    capture: Capture,
    scene: Scene | None,
    masks: Sequence[str] | Literal["auto"],
    options: Mapping[str, Mapping[str, Any]],
    plugins: PluginManager,
    *,
    known: Known,
    seed: int = 0,
) -> Capture:
    """Calls the mask sources in their order for the views that still lack a mask.

    `known` chooses the sources that need just that. Sources that `masks` names replace the masks of the capture's
    files, but not those of a source that was called before. `options` holds the options of each source, `seed` is
    the run's. An automatic source that needs cameras and cannot make masks, such as one without points, is a warning
    where most views have a mask.
    """
    names = [
        name
        for name in mask_source_names(masks, plugins)
        if needed_by(plugins.find("mask_source", name).component.traits) == known
    ]
    if not names:  # no photograph is decoded for nothing
        return capture
    if masks == "auto":
        needed = [i for i, view in enumerate(capture.views) if view.pixels().mask is None]
    else:
        first = known == "photographs"
        needed = [i for i, view in enumerate(capture.views) if first or view.mask is None]
    for name in names:
        if not needed:
            break
        source: MaskSource = plugins.create("mask_source", name, options.get(name), seed)
        try:
            found = source.masks(capture, scene)
        except CaptureError as error:
            if masks != "auto" or known != "cameras" or not _are_few(len(needed), capture):
                raise
            warnings.warn(str(error), stacklevel=2)
            continue
        if not isinstance(found, list | tuple) or len(found) != len(capture.views):
            count = f"of {len(found)} values " if isinstance(found, list | tuple) else ""
            raise PluginError(
                f"{plugins.find('mask_source', name).label} returned {a_value(found)} {count}from masks; return a list "
                f"of numpy arrays, or None, for the {len(capture.views)} views"
            )
        views = list(capture.views)
        for i in needed:
            mask = found[i]
            if mask is not None:
                # half the memory; the run's folder stores these values, too
                views[i] = replace(views[i], mask=mask.astype(np.float16))
        needed = [i for i in needed if found[i] is None]
        capture = replace(capture, views=tuple(views))
    return capture


def without_unmasked_views(capture: Capture) -> Capture:
    """The capture without the views that lack a mask, where these are at most half; a warning names them."""
    masked = [view.pixels().mask is not None for view in capture.views]
    unmasked = [view.name for view, has_mask in zip(capture.views, masked, strict=True) if not has_mask]
    if not unmasked or not _are_few(len(unmasked), capture):
        return capture
    warnings.warn(
        f"{len(unmasked)} of {len(capture.views)} photographs have no mask and are left out: "
        f"{', '.join(unmasked[:8])}{', …' if len(unmasked) > 8 else ''}; add their masks to use them",
        stacklevel=2,
    )
    return replace(capture, views=tuple(compress(capture.views, masked)))


def _are_few(unmasked: int, capture: Capture) -> bool:
    """Whether the masked views suffice for a fit without those that lack a mask."""
    return 2 * unmasked <= len(capture.views)


def with_automatic_masks(capture: Capture, plugins: PluginManager) -> Capture:
    """The capture with masks from the automatic sources that need no cameras, for views without a mask."""
    return apply_mask_sources(capture, None, "auto", {}, plugins, known="photographs")
