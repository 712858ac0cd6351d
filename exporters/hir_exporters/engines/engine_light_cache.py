"""Divides the light of an asset once for all formats of an export."""

from __future__ import annotations

from typing import Final

from hir_exporters.asset import Asset
from hir_exporters.content_cache import ContentCache, asset_key
from hir_exporters.engines.engine_light import EngineLight, engine_light

_CACHE: Final = ContentCache[EngineLight](2)
"""Formats of one export may differ in their number of lights."""


def cached_engine_light(asset: Asset, max_lights: int) -> EngineLight:
    """`engine_light(asset, max_lights)`, computed once for several formats.

    `asset` must be the one to export, before a format reduces its textures or its mesh: then the lights in one file and
    the residual environments of all formats belong to the same division. Raises `ExportError` where the asset has no
    environment.
    """
    return _CACHE.get(asset_key(asset, max_lights), lambda: engine_light(asset, max_lights))
