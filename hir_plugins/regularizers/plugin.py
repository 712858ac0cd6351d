"""Descriptors of the built-in regularizers."""

from __future__ import annotations

from hir_core.plugin import Component, hookimpl


@hookimpl
def hir_register_regularizers() -> list[Component]:
    return []
