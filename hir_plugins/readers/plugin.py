"""Descriptors of the built-in readers."""

from __future__ import annotations

from hir_core.plugin import Component, hookimpl


@hookimpl
def hir_register_capture_readers() -> list[Component]:
    return []
