"""Waits for something at import, as every command then does."""

from __future__ import annotations

import time

from hir_core.plugins import Component, hookimpl
from tests.hir_core.testing.faults.sound import Dispersion, descriptor

time.sleep(2.5)


class Term(Dispersion):
    """Sound in itself."""


@hookimpl
def hir_register_regularizers() -> list[Component]:
    return [descriptor(f"{__name__}:Term")]
