"""The gradient is half of that of the value."""

from __future__ import annotations

from typing import Any

from hir_core.plugins import Component, hookimpl
from tests.hir_core.testing.faults.sound import Dispersion, descriptor


class Term(Dispersion):
    def energy(self, scene: Any) -> Any:
        value = super().energy(scene)
        return 0.5 * (value + value.detach())


@hookimpl
def hir_register_regularizers() -> list[Component]:
    return [descriptor(f"{__name__}:Term")]
