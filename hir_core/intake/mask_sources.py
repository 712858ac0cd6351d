"""Masks of a capture from the installed mask sources, in their order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

from hir_core.capture import Capture

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import MaskSource
    from hir_core.plugins.manager import PluginManager
    from hir_core.scene import Scene


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
    with_cameras: bool,
    seed: int = 0,
) -> Capture:
    """Calls the mask sources in their order for the views that still lack a mask.

    `with_cameras` chooses between sources that need cameras and sources that do not. Sources that `masks` names
    replace masks that the views have already. `options` holds the options of each source, `seed` is the run's.
    """
    needed = [i for i, view in enumerate(capture.views) if view.pixels().mask is None]
    names = mask_source_names(masks, plugins)
    if masks != "auto":
        needed = list(range(len(capture.views))) if names else []
    for name in names:
        needs_cameras = "needs_cameras" in plugins.find("mask_source", name).component.traits
        if not needed or needs_cameras is not with_cameras:
            continue
        source: MaskSource = plugins.create("mask_source", name, options.get(name), seed)
        found = source.masks(capture, scene)
        views = list(capture.views)
        for i in needed:
            if found[i] is not None:
                views[i] = replace(views[i], mask=found[i])
        needed = [i for i in needed if found[i] is None]
        capture = replace(capture, views=tuple(views))
    return capture


def with_automatic_masks(capture: Capture, plugins: PluginManager) -> Capture:
    """The capture with masks from the automatic sources that need no cameras, for views without a mask."""
    return apply_mask_sources(capture, None, "auto", {}, plugins, with_cameras=False)
