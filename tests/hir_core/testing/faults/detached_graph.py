"""Computed in numpy: no gradient is left."""

from __future__ import annotations

from typing import Any

from hir_core.plugins import Component, hookimpl
from tests.hir_core.testing.faults.sound import Dispersion, descriptor


class Term(Dispersion):
    def energy(self, scene: Any) -> Any:
        positions = scene.mesh.positions.detach().numpy()
        return scene.mesh.positions.new_tensor(((positions - positions.mean(axis=0)) ** 2).sum())


@hookimpl
def hir_register_regularizers() -> list[Component]:
    return [descriptor(f"{__name__}:Term")]
