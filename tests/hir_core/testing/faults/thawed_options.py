"""Options that can change after they were checked."""

from __future__ import annotations

from dataclasses import dataclass

from hir_core.plugins import Component, hookimpl
from tests.hir_core.testing.faults.sound import Dispersion, descriptor


@dataclass
class Thawed:
    """Not frozen."""

    strength: float = 1.0
    """Factor of the term."""


class Term(Dispersion):
    """Sound in itself."""


@hookimpl
def hir_register_regularizers() -> list[Component]:
    return [descriptor(f"{__name__}:Term", config=Thawed)]
