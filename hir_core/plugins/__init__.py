"""The plugin interface: what a light `plugin.py` imports. Nothing here imports torch."""

from hir_core.plugins.component import API_VERSION, Component, NoOptions, hookimpl

__all__ = ["API_VERSION", "Component", "NoOptions", "hookimpl"]
