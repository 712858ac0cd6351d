"""Descriptors of the built-in exporters."""

from __future__ import annotations

from hir_core.plugin import Component, hookimpl


@hookimpl
def hir_register_exporters() -> list[Component]:
    return []
