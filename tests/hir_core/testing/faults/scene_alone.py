"""Returns the scene alone, without the capture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hir_core.plugins import Component, NoOptions, hookimpl
from hir_core.plugins.interfaces import Initializer


class Surface(Initializer):
    def __init__(self, config: NoOptions) -> None: ...

    def initialize(self, capture: Any, scene: Any, workspace: Path) -> Any:

        from hir_core.errors import StageError
        from hir_core.scene import Scene
        from hir_core.testing.captures import surface_mesh

        if capture.points is None:
            raise StageError("this initializer needs a capture with points; name another one before it")
        mesh = surface_mesh().mesh
        return Scene(mesh)


@hookimpl
def hir_register_initializers() -> list[Component]:
    needs, traits = ("torch", "jaxtyping"), frozenset({"makes_surface"})
    return [Component("alone", f"{__name__}:Surface", summary="A known surface.", requires=needs, traits=traits)]
