"""Descriptors of the built-in geometry renderers."""

from __future__ import annotations

from hir_core.plugin import Component, hookimpl


@hookimpl
def hir_register_geometry_renderers() -> list[Component]:
    return []
