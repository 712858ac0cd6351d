"""Descriptors of the built-in regularizers."""

from __future__ import annotations

from hir_core.plugin import Component, NoOptions, hookimpl
from hir_plugins.regularizers.mesh_options import EdgeLengthOptions, LaplacianOptions

LAPLACIAN = Component(
    name="laplacian",
    target="hir_plugins.regularizers.laplacian:Laplacian",
    config=LaplacianOptions,
    summary="Keeps each vertex near the mean of its neighbours.",
    requires=("torch", "jaxtyping"),
    extra="reconstruct",
    traits=frozenset({"differentiable", "rigid_invariant"}),
)

NORMAL_CONSISTENCY = Component(
    name="normal_consistency",
    target="hir_plugins.regularizers.normal_consistency:NormalConsistency",
    config=NoOptions,
    summary="Keeps neighbouring triangles at small angles.",
    requires=("torch", "jaxtyping"),
    extra="reconstruct",
    traits=frozenset({"differentiable", "rigid_invariant"}),
)

EDGE_LENGTH = Component(
    name="edge_length",
    target="hir_plugins.regularizers.edge_length:EdgeLength",
    config=EdgeLengthOptions,
    summary="Keeps edges short.",
    requires=("torch", "jaxtyping"),
    extra="reconstruct",
    traits=frozenset({"differentiable", "rigid_invariant"}),
)


@hookimpl
def hir_register_regularizers() -> list[Component]:
    return [
        LAPLACIAN,
        NORMAL_CONSISTENCY,
        EDGE_LENGTH,
    ]
