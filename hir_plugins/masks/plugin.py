"""Descriptors of the built-in masks."""

from __future__ import annotations

from hir_core.plugin import Component, hookimpl


@hookimpl
def hir_register_mask_sources() -> list[Component]:
    return []
