"""Renders exported files and the fitted scene with equal cameras, renderer and random numbers, and compares them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from hir_exporters.asset import Asset, AssetEnvironment, AssetMesh
from hir_exporters.reading.asset_decoding import DecodedAsset

from hir_core.capture import Array, Camera
from hir_core.metrics import OBJECT_COVERAGE, Image, composite, psnr_without_noise, unassociate
from hir_core.rendering.reference_renderer import reference_renderer, render_view
from hir_core.scene.asset_conversion import scene_from_asset
from hir_core.scene.frames import move_scene
from hir_core.stages.export.render_threshold import GOOD_PSNR

if TYPE_CHECKING:
    from hir_core.plugins.manager import PluginManager
    from hir_core.scene import Mesh, Scene

VIEWS: Final = 4
"""Number of cameras that a file is rendered from, evenly spaced over those of the run."""


class Rerender:
    """Renders the fitted scene once, and compares files with it.

    `cameras` are in the asset frame; `working_from_asset` (4×4) moves them to the frame in which renderers work.
    `side` is the maximum of the longer image side in pixels, `samples` the number of paths per pixel, of which each of
    two renders gets half.
    """

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
        of_each = -(-samples // 2)
        self._samples, self._side = 2 * of_each, side
        self._name, self._renderer = reference_renderer(
            plugins, "", {"render_samples": of_each}, bounces, light=asset.environment
        )
        self._last_mesh: tuple[AssetMesh, Mesh] | None = None
        self.light_in_world = asset.environment is not None and asset.environment.frame == "world"

    @cached_property
    def _fitted(self) -> dict[str, tuple[Image, Image]]:
        return self._pictures(self._asset)

    def compare(self, written: DecodedAsset, light: AssetEnvironment | None) -> dict[str, Any]:
        """PSNR in dB of renders of a file against renders of the fitted scene, JSON-able.

        `psnr.object` is over pixels that the fitted object covers, `psnr.views` the same for each camera. Where it is
        below `GOOD_PSNR`, `costs` has the PSNR of the fitted scene with one part of the file: its material, mesh or
        light. `light` is that of the file, in world axes; it is used where the run's light is fixed in the world.
        """
        fitted = self._asset.environment
        lit = light if light is not None and self.light_in_world else fitted
        if lit is not None and fitted is not None:
            lit = replace(lit, lamp=fitted.lamp)  # files describe a lamp near the camera and contain none
        views = self._views(replace(self._asset, mesh=written.mesh, material=written.material, environment=lit))
        result: dict[str, Any] = {
            "rendered": written.interpretation,
            "renderer": self._name,
            "samples": self._samples,
            "side": self._side,
            "psnr": {"object": _mean(views), "views": views},
        }
        if _mean(views) < GOOD_PSNR:
            # one part at a time: material and normals of the fit belong to its own UVs; the mesh first, since the
            # renderer has just prepared it
            parts = {
                "the mesh": replace(self._asset, mesh=written.mesh),
                "the material": replace(self._asset, material=written.material),
            }
            if light is not None and self.light_in_world:
                parts["the light"] = replace(self._asset, environment=lit)
            result["costs"] = {name: _mean(self._views(part)) for name, part in parts.items()}
        return result

    def _pictures(self, asset: Asset) -> dict[str, tuple[Image, Image]]:
        """Two renders from each camera, with independent noise: the product of their differences has no noise term."""
        scene: Scene = move_scene(scene_from_asset(asset), self._working_from_asset).to(self._device)
        if self._last_mesh is not None and self._last_mesh[0] is asset.mesh:
            scene = replace(scene, mesh=self._last_mesh[1])  # what the renderer prepared for it serves again
        self._last_mesh = asset.mesh, scene.mesh

        def rendered(name: str, noise: str) -> Image:
            return render_view(self._renderer, scene, self._cameras[name], f"{name} {noise}")

        return {name: (rendered(name, "first"), rendered(name, "second")) for name in self._cameras}

    def _views(self, asset: Asset) -> dict[str, float]:
        """PSNR of each camera's picture of an asset against that of the fitted scene, without the noise of both."""
        values, fitted = {}, self._fitted
        for name, pictures in self._pictures(asset).items():
            truths = fitted[name]
            where = np.mean([truth[..., 3] for truth in truths], axis=0) > OBJECT_COVERAGE
            first, second = (
                composite(*unassociate(picture)) - composite(*unassociate(truth))
                for picture, truth in zip(pictures, truths, strict=True)
            )
            value = psnr_without_noise(first, second, np.zeros_like(first), where)
            if value is not None:  # None: the camera does not see the object
                values[name] = round(value, 2)
        return values


def _mean(views: Mapping[str, float]) -> float:
    """Mean over the cameras; 0 where no camera sees the object."""
    return round(float(np.mean(list(views.values()))), 2) if views else 0.0


def _small(camera: Camera, side: int) -> Camera:
    return camera.pinhole().downsampled(max(1, -(-max(camera.width, camera.height) // side)))
