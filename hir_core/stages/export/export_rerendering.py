"""Renders exported files and the fitted scene with equal cameras, renderer and random numbers, and compares them."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from hir_exporters.asset import Asset, AssetEnvironment
from hir_exporters.reading.asset_decoding import DecodedAsset

from hir_core.capture import Array, Camera
from hir_core.metrics import OBJECT_COVERAGE, Image, composite, psnr, unassociate
from hir_core.rendering.reference_renderer import reference_renderer, render_view
from hir_core.scene.asset_conversion import scene_from_asset
from hir_core.scene.frames import move_scene
from hir_core.stages.export.render_threshold import GOOD_PSNR

if TYPE_CHECKING:
    from hir_core.plugins.manager import PluginManager
    from hir_core.scene import Scene

VIEWS: Final = 4
"""Number of cameras that a file is rendered from, evenly spaced over those of the run."""

RETRY_SAMPLE_FACTOR: Final = 8
"""Factor of the paths per pixel in the second comparison. Equal random numbers cancel most noise between similar
materials; where the first comparison is bad, noise may be the reason."""


class Rerender:
    """Renders the fitted scene once, and compares files with it.

    `cameras` are in the asset frame; `working_from_asset` (4×4) moves them to the frame in which renderers work.
    `side` is the maximum of the longer image side in pixels, `samples` the number of paths per pixel.
    """

    _with_fewer_paths: Rerender | None = None
    """The first comparison, in the second one."""

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
        self._name, self._renderer = reference_renderer(
            self._plugins, "", {"render_samples": samples}, self._bounces, light=self._asset.environment
        )

    @cached_property
    def _fitted(self) -> dict[str, Image]:
        return self._pictures(self._asset)

    @cached_property
    def _finer(self) -> Rerender:
        """The same comparison with more paths per pixel."""
        finer = copy(self)
        finer.__dict__.pop("_fitted", None)
        finer._sample(RETRY_SAMPLE_FACTOR * self._samples)
        finer._with_fewer_paths = self
        return finer

    def compare(self, written: DecodedAsset, light: AssetEnvironment | None) -> dict[str, Any]:
        """PSNR in dB of renders of a file against renders of the fitted scene, JSON-able.

        `psnr.object` is over pixels that the fitted object covers, `psnr.views` the same for each camera. Below
        `GOOD_PSNR` the file is rendered again with `RETRY_SAMPLE_FACTOR` times the paths. Where it is still below,
        `costs` has the PSNR of the fitted scene with one part of the file: its material, mesh or light. `light` is
        that of the file, in world axes; it is used where the run's light is fixed in the world.
        """
        fitted = self._asset.environment
        lit = light if light is not None and self.light_in_world else fitted
        if lit is not None and fitted is not None:
            lit = replace(lit, lamp=fitted.lamp)  # files describe a lamp near the camera and contain none
        whole = replace(self._asset, mesh=written.mesh, material=written.material, environment=lit)
        views = self._views(self._pictures(whole))
        if _mean(views) < GOOD_PSNR and self._with_fewer_paths is None:
            return self._finer.compare(written, light)
        result: dict[str, Any] = {
            "rendered": written.interpretation,
            "renderer": self._name,
            "samples": self._samples,
            "side": self._side,
            "psnr": {"object": _mean(views), "views": views},
        }
        if _mean(views) < GOOD_PSNR:
            # one part at a time: material and normals of the fit belong to its own UVs
            parts = {
                "the material": replace(self._asset, material=written.material),
                "the mesh": replace(self._asset, mesh=written.mesh),
            }
            if light is not None and self.light_in_world:
                parts["the light"] = replace(self._asset, environment=lit)
            result["costs"] = {name: self._cost(part) for name, part in parts.items()}
        return result

    def _cost(self, part: Asset) -> float:
        """PSNR of the fitted scene with one part of a file. Noise lowers it, so a part that is good with few paths
        needs no more.
        """
        first = self._with_fewer_paths
        if first is not None and (value := _mean(first._views(first._pictures(part)))) >= GOOD_PSNR:
            return value
        return _mean(self._views(self._pictures(part)))

    def _pictures(self, asset: Asset) -> dict[str, Image]:
        scene: Scene = move_scene(scene_from_asset(asset), self._working_from_asset).to(self._device)
        return {name: render_view(self._renderer, scene, camera, name) for name, camera in self._cameras.items()}

    def _views(self, pictures: Mapping[str, Image]) -> dict[str, float]:
        values = {}
        for name, picture in pictures.items():
            truth = self._fitted[name]
            where = truth[..., 3] > OBJECT_COVERAGE
            value = psnr(composite(*unassociate(picture)), composite(*unassociate(truth)), where)
            if value is not None:  # None: the camera does not see the object
                values[name] = round(value, 2)
        return values


def _mean(views: Mapping[str, float]) -> float:
    """Mean over the cameras; 0 where no camera sees the object."""
    return round(float(np.mean(list(views.values()))), 2) if views else 0.0


def _small(camera: Camera, side: int) -> Camera:
    return camera.pinhole().downsampled(max(1, -(-max(camera.width, camera.height) // side)))
