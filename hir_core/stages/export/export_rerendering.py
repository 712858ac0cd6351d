"""Renders what was written beside what was fitted: the same cameras, the same renderer, the same random numbers."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from hir_exporters.asset import Asset, AssetEnvironment
from hir_exporters.reading.written_asset import WrittenAsset

from hir_core.capture import Array, Camera
from hir_core.metrics import OBJECT_COVERAGE, Image, composite, psnr, unassociate
from hir_core.rendering.reference_renderer import reference_renderer, render_view
from hir_core.scene.asset_conversion import scene_from_asset
from hir_core.scene.frames import move_scene

if TYPE_CHECKING:
    from hir_core.plugins.manager import PluginManager
    from hir_core.scene import Scene

VIEWS: Final = 4
"""Cameras that a file is rendered from, spread over the run's."""

FINER: Final = 8
"""Equal random numbers hide most noise while materials are alike; where they are not, so many times the paths are
taken."""


class Rerender:
    """The fitted scene's pictures, rendered once, and the comparison of files with them.

    `cameras` are in the asset's frame, `working_from_asset` (4×4) leads to the frame that renderers are used to.
    `side` bounds the pictures' longer side in pixels, `samples` are paths for each pixel.
    """

    _is_finer = False

    def __init__(
        self,
        asset: Asset,
        cameras: Mapping[str, Camera],
        working_from_asset: Array,
        plugins: PluginManager,
        *,
        side: int = 128,
        samples: int = 64,
        bounces: int | None = None,
        device: str = "cpu",
    ) -> None:
        names = list(cameras)
        chosen = sorted({round(i * (len(names) - 1) / max(VIEWS - 1, 1)) for i in range(VIEWS)})
        self._cameras = {
            names[i]: _small(cameras[names[i]].transformed(working_from_asset), side) for i in chosen if names
        }
        self._working_from_asset, self._asset, self._device = working_from_asset, asset, device
        self._plugins, self._bounces = plugins, bounces
        self._sample(samples)
        self._side = side
        self.light_in_world = asset.environment is not None and asset.environment.frame == "world"

    def _sample(self, samples: int) -> None:
        self._samples = samples
        self._name, self._renderer = reference_renderer(self._plugins, "", {"render_samples": samples}, self._bounces)

    @cached_property
    def _fitted(self) -> dict[str, Image]:
        return self._pictures(self._asset)

    @cached_property
    def _finer(self) -> Rerender:
        """The same with more paths, for files whose first comparison may be noise."""
        finer = copy(self)
        finer.__dict__.pop("_fitted", None)
        finer._sample(FINER * self._samples)
        finer._is_finer = True
        return finer

    def compare(self, written: WrittenAsset, light: AssetEnvironment | None) -> dict[str, Any]:
        """PSNR in dB of a file's pictures against the fitted scene's, JSON-able.

        `psnr.object` is over pixels that the fitted object covers, `psnr.views` the same of each camera. Below 40 dB
        it is rendered again with `FINER` times the paths, and where that stays so `costs` has the PSNR with one part of
        the file alone (its material, mesh or light) in the fitted scene. `light` of the file, in world axes, is used
        where the run's light stands in the world.
        """
        lit = light if light is not None and self.light_in_world else self._asset.environment
        whole = replace(self._asset, mesh=written.mesh, material=written.material, environment=lit)
        views = self._views(self._pictures(whole))
        if _mean(views) < GOOD_PSNR and not self._is_finer:
            return self._finer.compare(written, light)
        found: dict[str, Any] = {
            "rendered": written.understood,
            "renderer": self._name,
            "samples": self._samples,
            "side": self._side,
            "psnr": {"object": _mean(views), "views": views},
        }
        if _mean(views) < GOOD_PSNR:
            # what was fitted under its own normals and UVs takes only one part at a time from the file
            parts = {
                "the material": replace(self._asset, material=written.material),
                "the mesh": replace(self._asset, mesh=written.mesh),
            }
            if lit is not self._asset.environment:
                parts["the light"] = replace(self._asset, environment=lit)
            found["costs"] = {name: _mean(self._views(self._pictures(part))) for name, part in parts.items()}
        return found

    def _pictures(self, asset: Asset) -> dict[str, Image]:
        scene: Scene = move_scene(scene_from_asset(asset), self._working_from_asset).to(self._device)
        return {name: render_view(self._renderer, scene, camera, name) for name, camera in self._cameras.items()}

    def _views(self, pictures: Mapping[str, Image]) -> dict[str, float]:
        found = {}
        for name, picture in pictures.items():
            truth = self._fitted[name]
            where = truth[..., 3] > OBJECT_COVERAGE
            value = psnr(composite(*unassociate(picture)), composite(*unassociate(truth)), where)
            if value is not None:  # a camera that does not see the object tells nothing
                found[name] = round(value, 2)
        return found


def _mean(views: Mapping[str, float]) -> float:
    """Mean over the cameras; 0 where no camera sees the object."""
    return round(float(np.mean(list(views.values()))), 2) if views else 0.0


def _small(camera: Camera, side: int) -> Camera:
    return camera.downsampled(max(1, -(-max(camera.width, camera.height) // side)))


GOOD_PSNR: Final = 40.0
"""dB over the object's pixels under which a re-rendered file is warned of."""
