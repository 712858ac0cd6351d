"""Returns one value for each pixel in the place of three."""

from __future__ import annotations

from typing import Any

from hir_core.plugins import Component, hookimpl
from tests.hir_core.testing.faults.sound_renderer import Traced, descriptor


class Renderer(Traced):
    def shown(self, radiance: Any) -> Any:
        return radiance.mean(dim=1)


@hookimpl
def hir_register_reflectance_renderers() -> list[Component]:
    return [descriptor(f"{__name__}:Renderer")]
