"""Returns the surface with z up, as its file has it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hir_core.plugins import Component, NoOptions, hookimpl
from hir_core.plugins.interfaces import Initializer


class ZUp(Initializer):
    def __init__(self, config: NoOptions) -> None: ...

    def initialize(self, capture: Any, scene: Any, workspace: Path) -> tuple[Any, Any]:
        import torch
        import trimesh

        from hir_core.errors import StageError
        from hir_core.scene import Mesh, Scene, Topology
        from hir_core.testing.captures import BALLS

        if capture.points is None:
            raise StageError("this initializer needs a capture with points; name another one before it")
        balls = [trimesh.creation.icosphere(3, radius).apply_translation(centre) for centre, radius in BALLS]
        union = trimesh.util.concatenate(balls)
        outside = np.linalg.norm(union.triangles_center[:, None] - [c for c, _ in BALLS], axis=2) > [
            r * 0.97 for _, r in BALLS
        ]
        union.update_faces(outside.all(axis=1))
        union.remove_unreferenced_vertices()
        z_up = torch.from_numpy(union.vertices @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0.0]])).float()
        return capture, Scene(Mesh(z_up, Topology(torch.from_numpy(np.array(union.faces, dtype=np.int64)))))


@hookimpl
def hir_register_initializers() -> list[Component]:
    needs, traits = ("torch", "jaxtyping"), frozenset({"makes_surface"})
    return [Component("z_up", f"{__name__}:ZUp", summary="A surface with z up.", requires=needs, traits=traits)]
