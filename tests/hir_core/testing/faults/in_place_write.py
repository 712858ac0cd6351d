"""Clamps the roughness of the scene that it is given, at each call."""

from __future__ import annotations

from typing import Any

from hir_core.plugins import Component, hookimpl
from tests.hir_core.testing.faults.sound import Dispersion, descriptor


class Term(Dispersion):
    def energy(self, scene: Any) -> Any:
        if scene.material is not None:
            scene.material.roughness.clamp_(max=0.4)
        return super().energy(scene)


@hookimpl
def hir_register_regularizers() -> list[Component]:
    return [descriptor(f"{__name__}:Term")]
