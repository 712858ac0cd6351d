"""Documents an ideal that is not the scene of the least value."""

from __future__ import annotations

from typing import Any

from hir_core.plugins import Component, hookimpl
from tests.hir_core.testing.faults.sound import Dispersion, descriptor


class Term(Dispersion):
    def energy(self, scene: Any) -> Any:
        value = super().energy(scene)
        return value if scene.material is None else value + (scene.material.roughness - 0.5).square().mean()


def ideal(scene: Any) -> Any:
    from dataclasses import replace

    mesh = scene.mesh.with_positions(scene.mesh.positions * 0)
    return replace(scene, mesh=mesh, material=replace(scene.material, roughness=scene.material.roughness * 0 + 0.55))


@hookimpl
def hir_register_regularizers() -> list[Component]:
    traits = frozenset({"differentiable", "rigid_invariant", "material"})
    return [descriptor(f"{__name__}:Term", testing=f"{__name__}:ideal", traits=traits)]
