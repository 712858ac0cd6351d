"""Divides the light of an asset once for all formats of an export."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from threading import Lock
from typing import Final

import numpy as np

from hir_exporters.asset import Asset
from hir_exporters.engines.engine_light import EngineLight, engine_light
from hir_exporters.light.environment_map import world_radiance

_CAPACITY: Final = 2
"""Formats of one export may differ in their number of lights."""


class EngineLightCache:
    """`engine_light` of the last few assets, found by their content: arrays may be changed between two exports."""

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._lights: OrderedDict[bytes, EngineLight] = OrderedDict()
        self._lock = Lock()

    def light(self, asset: Asset, max_lights: int) -> EngineLight:
        """`engine_light(asset, max_lights)`; a thread that asks for what another one computes waits for it."""
        key = _content_hash(asset, max_lights)
        with self._lock:
            if key not in self._lights:
                self._lights[key] = engine_light(asset, max_lights)
            self._lights.move_to_end(key)
            while len(self._lights) > self._capacity:
                self._lights.popitem(last=False)
            return self._lights[key]


_CACHE = EngineLightCache(_CAPACITY)


def cached_engine_light(asset: Asset, max_lights: int) -> EngineLight:
    """`engine_light(asset, max_lights)`, computed once for several formats.

    `asset` must be the one to export, before a format reduces its textures or its mesh: then the lights in one file and
    the residual environments of all formats belong to the same division. Raises `ExportError` where the asset has no
    environment.
    """
    return _CACHE.light(asset, max_lights)


def _content_hash(asset: Asset, max_lights: int) -> bytes:
    """SHA-256 of everything that `engine_light` reads."""
    mesh, material = asset.mesh, asset.material
    radiance, warnings = world_radiance(asset)
    digest = hashlib.sha256(repr((max_lights, material.model, material.dielectric_f0, warnings)).encode())
    arrays = (
        *(mesh.positions, mesh.normals, mesh.uvs, mesh.faces),
        *(material.diffuse_albedo, material.specular_albedo, material.roughness, material.normal, material.metalness),
        radiance,
    )
    for array in arrays:
        digest.update(repr(None if array is None else array.shape).encode())
        if array is not None:
            digest.update(np.ascontiguousarray(array).data)
    return digest.digest()
