"""A reflectance renderer that wraps another one: `mitsuba_ggx`."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, final

import numpy as np

from hir_core.errors import ConfigError
from hir_core.plugins.interfaces import PreparedReflectance, ReflectanceRenderer
from hir_core.plugins.manager import PluginManager
from hir_example.options import SupersampledOptions

if TYPE_CHECKING:
    from torch import Tensor

    from hir_core.capture import Camera, Capture
    from hir_core.scene import Scene


@final
class Supersampled(ReflectanceRenderer):
    """Radiance of the wrapped renderer; pictures are rendered `factor` times larger and averaged."""

    def __init__(self, config: SupersampledOptions) -> None:
        if config.factor < 1:
            raise ConfigError("reflectance_renderer.supersampled.factor must be at least 1")
        self._factor = config.factor
        self._inner: ReflectanceRenderer = PluginManager.discover().create(
            "reflectance_renderer", "mitsuba_ggx", {"max_depth": config.max_depth}
        )

    def prepare(self, scene: Scene, capture: Capture, downsample: int = 1) -> PreparedReflectance:
        """The wrapped renderer's."""
        return self._inner.prepare(scene, capture, downsample)

    def render(self, scene: Scene, camera: Camera) -> Tensor:
        """Averages pixels; premultiplied colours may be averaged."""
        factor = self._factor
        intrinsics = np.diag([factor, factor, 1.0]) @ camera.intrinsics
        large = replace(camera, intrinsics=intrinsics, width=factor * camera.width, height=factor * camera.height)
        image = self._inner.render(scene, large)
        return image.reshape(camera.height, factor, camera.width, factor, 4).mean(dim=(1, 3))
