"""Seeds the generator that the whole run draws from."""

from __future__ import annotations

from typing import Any

from hir_core.plugins import Component, hookimpl
from tests.hir_core.testing.faults.sound import Dispersion, descriptor


class Term(Dispersion):
    def prepare(self, scene: Any) -> Any:
        import torch

        torch.manual_seed(0)
        return self.energy


@hookimpl
def hir_register_regularizers() -> list[Component]:
    return [descriptor(f"{__name__}:Term", requires=("torch",))]
