"""Caches results that several formats of one export share, found by the content of the asset."""

from __future__ import annotations

import hashlib
import json
from collections import OrderedDict
from collections.abc import Callable
from threading import Lock
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import Asset
from hir_exporters.asset_lamp import lamp_description

_Result = TypeVar("_Result")


class ContentCache(Generic[_Result]):
    """The last `capacity` results. Keys are hashes of content: arrays may be changed between two exports."""

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._results: OrderedDict[bytes, _Result] = OrderedDict()
        self._lock = Lock()

    def get(self, key: bytes, compute: Callable[[], _Result]) -> _Result:
        """The result of `compute()`; a thread that asks for what another one computes waits for it."""
        with self._lock:
            if key not in self._results:
                self._results[key] = compute()
            self._results.move_to_end(key)
            while len(self._results) > self._capacity:
                self._results.popitem(last=False)
            return self._results[key]


def asset_key(asset: Asset, *options: object) -> bytes:
    """SHA-256 of a valid asset, without its name, and of options."""
    mesh, material, light = asset.mesh, asset.material, asset.environment
    words = [material.model, material.dielectric_f0, json.dumps(dict(asset.provenance), sort_keys=True), *options]
    arrays: list[NDArray[Any]] = [mesh.positions, mesh.normals, mesh.uvs, mesh.faces]
    arrays += [material.diffuse_albedo, material.specular_albedo, material.roughness]
    arrays += [array for array in (material.normal, material.metalness) if array is not None]
    if light is not None:
        words.append(light.frame)
        arrays += [light.radiance, light.to_world]
        if light.lamp is not None:
            words.append(json.dumps(lamp_description(light.lamp)))
    digest = hashlib.sha256(repr((words, material.normal is None, [array.shape for array in arrays])).encode())
    for array in arrays:
        digest.update(np.ascontiguousarray(array).data)
    return digest.digest()
