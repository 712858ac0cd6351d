"""One number for each vertex."""

from __future__ import annotations

from typing import Any

from hir_core.plugins import Component, hookimpl
from tests.hir_core.testing.faults.sound import Dispersion, descriptor


class Term(Dispersion):
    def energy(self, scene: Any) -> Any:
        return scene.mesh.positions.square().sum(dim=1)


@hookimpl
def hir_register_regularizers() -> list[Component]:
    return [descriptor(f"{__name__}:Term")]
