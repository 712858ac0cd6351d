"""Mask source: masks that come with the photographs."""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Capture
from hir_core.plugins import NoOptions
from hir_core.plugins.interfaces import MaskSource

if TYPE_CHECKING:
    from hir_core.scene import Scene


@final
class Alpha(MaskSource):
    """The alpha channel, or the mask file that the capture's camera file names."""

    def __init__(self, config: NoOptions) -> None:
        del config

    def masks(self, capture: Capture, scene: Scene | None) -> list[NDArray[np.float32] | None]:
        """One mask (H, W) for each view; None for photographs without one."""
        del scene
        return [view.pixels().mask for view in capture.views]
