"""Takes the name of a term of hir."""

from __future__ import annotations

from hir_core.plugins import Component, hookimpl
from tests.hir_core.testing.faults.sound import Dispersion, descriptor


class Term(Dispersion):
    """Sound in itself."""


@hookimpl
def hir_register_regularizers() -> list[Component]:
    return [descriptor(f"{__name__}:Term", name="laplacian")]
