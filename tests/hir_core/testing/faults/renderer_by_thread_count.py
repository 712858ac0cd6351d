"""Has other values with several threads."""

from __future__ import annotations

from typing import Any

from hir_core.plugins import Component, NoOptions, hookimpl
from hir_core.plugins.interfaces import GeometryRenderer


class Renderer(GeometryRenderer):
    def __init__(self, config: NoOptions) -> None:
        from hir_plugins.geometry_renderers.contour import Contour
        from hir_plugins.geometry_renderers.options import ContourOptions

        self.inner = Contour(ContourOptions())

    def prepare(self, views: Any, downsample: int = 1) -> Any:
        return self.inner.prepare(views, downsample)

    def overlap(self, mesh: Any, targets: Any) -> Any:
        return self.inner.overlap(mesh, targets)

    def render(self, mesh: Any, cameras: Any) -> Any:
        import torch

        return self.inner.render(mesh, cameras) * (0.99 if torch.get_num_threads() > 1 else 1.0)


@hookimpl
def hir_register_geometry_renderers() -> list[Component]:
    needs, traits = ("torch", "jaxtyping", "numba", "scipy"), frozenset({"differentiable"})
    return [Component("varying", f"{__name__}:Renderer", summary="Silhouettes.", requires=needs, traits=traits)]
