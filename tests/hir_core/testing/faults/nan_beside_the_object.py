"""Divides by the brightness, which is 0 beside the object."""

from __future__ import annotations

from typing import Any

from hir_core.plugins import Component, hookimpl
from tests.hir_core.testing.faults.sound_renderer import Traced, descriptor


class Renderer(Traced):
    def shown(self, radiance: Any) -> Any:
        mean = radiance.mean(dim=1, keepdim=True)
        return mean * (radiance / mean)


@hookimpl
def hir_register_reflectance_renderers() -> list[Component]:
    return [descriptor(f"{__name__}:Renderer")]
