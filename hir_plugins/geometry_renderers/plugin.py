"""Descriptors of the built-in geometry renderers."""

from __future__ import annotations

from hir_core.plugins import Component, hookimpl
from hir_plugins.geometry_renderers.options import ContourOptions, SoftSilhouetteOptions

CONTOUR = Component(
    name="contour",
    target="hir_plugins.geometry_renderers.contour:Contour",
    config=ContourOptions,
    summary="Exact silhouette areas and gradients from the outline alone; antialiased coverage.",
    requires=("torch", "jaxtyping"),
    extra="reconstruct",
    traits=frozenset({"differentiable"}),
)

SOFT_SILHOUETTE = Component(
    name="soft_silhouette",
    target="hir_plugins.geometry_renderers.soft_silhouette:SoftSilhouette",
    config=SoftSilhouetteOptions,
    summary="Soft Rasterizer's blurred silhouettes (Liu et al. 2019), as the paper uses them.",
    requires=("torch", "jaxtyping"),
    extra="reconstruct",
    traits=frozenset({"differentiable"}),
)


@hookimpl
def hir_register_geometry_renderers() -> list[Component]:
    return [CONTOUR, SOFT_SILHOUETTE]
