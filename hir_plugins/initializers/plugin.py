"""Descriptors of the built-in initializers."""

from __future__ import annotations

from hir_core.plugin import Component, hookimpl


@hookimpl
def hir_register_initializers() -> list[Component]:
    return []
