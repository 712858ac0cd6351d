"""The masks that a run finds without cameras."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from hir_core.capture import Capture

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import MaskSource
    from hir_core.plugins.manager import PluginManager


def with_automatic_masks(capture: Capture, plugins: PluginManager) -> Capture:
    """The capture with masks from the automatic sources that need no cameras, for views without a mask."""
    for registered in plugins.components("mask_source"):
        traits = registered.component.traits
        if "automatic" not in traits or "needs_cameras" in traits or registered.missing:
            continue
        lacking = [i for i, view in enumerate(capture.views) if view.pixels().mask is None]
        if not lacking:
            break
        source: MaskSource = plugins.create("mask_source", registered.component.name)
        views, masks = list(capture.views), source.masks(capture, None)
        for i in lacking:
            views[i] = replace(views[i], mask=masks[i]) if masks[i] is not None else views[i]
        capture = replace(capture, views=tuple(views))
    return capture
