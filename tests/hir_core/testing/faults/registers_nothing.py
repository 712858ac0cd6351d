"""Has a term, and a function that would register it, without `@hookimpl`."""

from __future__ import annotations

from hir_core.plugins import Component


def hir_register_regularizers() -> list[Component]:
    return [Component("forgotten", "tests.hir_core.testing.faults.sound:Sound", "forgotten")]
