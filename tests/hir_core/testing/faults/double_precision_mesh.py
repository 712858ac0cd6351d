"""Returns vertices as float64, as numpy computed them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hir_core.plugins import Component, NoOptions, hookimpl
from hir_core.plugins.interfaces import Initializer


class Surface(Initializer):
    def __init__(self, config: NoOptions) -> None: ...

    def initialize(self, capture: Any, scene: Any, workspace: Path) -> tuple[Any, Any]:
        import torch

        from hir_core.errors import StageError
        from hir_core.scene import Mesh, Scene, Topology
        from hir_core.testing.captures import surface_mesh

        if capture.points is None:
            raise StageError("this initializer needs a capture with points; name another one before it")
        mesh = surface_mesh().mesh
        positions = torch.from_numpy(mesh.positions.numpy().astype(np.float64))
        return capture, Scene(Mesh(positions, Topology(mesh.faces)))


@hookimpl
def hir_register_initializers() -> list[Component]:
    needs, traits = ("torch", "jaxtyping"), frozenset({"makes_surface"})
    return [Component("precise", f"{__name__}:Surface", summary="A known surface.", requires=needs, traits=traits)]
