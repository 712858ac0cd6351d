"""Descriptors of the built-in reflectance renderers."""

from __future__ import annotations

from hir_core.plugin import Component, hookimpl


@hookimpl
def hir_register_reflectance_renderers() -> list[Component]:
    return []
