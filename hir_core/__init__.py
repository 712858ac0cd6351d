"""`hir`: photographs in, a game-ready asset out. Importing this package loads nothing heavy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hir_exporters.scene_format import load_scene

    from hir_core.pipeline import reconstruct

__all__ = ["load_scene", "reconstruct"]
__version__ = "0.1.0"

_HOME = {"load_scene": "hir_exporters.scene_format", "reconstruct": "hir_core.pipeline"}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOME[name]), name)
