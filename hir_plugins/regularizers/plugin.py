"""Descriptors of the built-in regularizers."""

from __future__ import annotations

from hir_core.plugins import Component, NoOptions, hookimpl
from hir_plugins.regularizers.material_options import (
    AlbedoScaleOptions,
    BilateralSpecularOptions,
    JointBilateralOptions,
    TotalVariationOptions,
)
from hir_plugins.regularizers.mesh_options import EdgeLengthOptions, LaplacianOptions

LAPLACIAN = Component(
    name="laplacian",
    target="hir_plugins.regularizers.laplacian:Laplacian",
    config=LaplacianOptions,
    summary="Keeps each vertex near the mean of its neighbours.",
    requires=("torch", "jaxtyping"),
    extra="reconstruct",
    traits=frozenset({"differentiable", "rigid_invariant"}),
    testing="hir_plugins.regularizers.contract_inputs:single_point",
)

NORMAL_CONSISTENCY = Component(
    name="normal_consistency",
    target="hir_plugins.regularizers.normal_consistency:NormalConsistency",
    config=NoOptions,
    summary="Keeps neighbouring triangles at small angles.",
    requires=("torch", "jaxtyping"),
    extra="reconstruct",
    traits=frozenset({"differentiable", "rigid_invariant"}),
    testing="hir_plugins.regularizers.contract_inputs:flat_sheet",
)

EDGE_LENGTH = Component(
    name="edge_length",
    target="hir_plugins.regularizers.edge_length:EdgeLength",
    config=EdgeLengthOptions,
    summary="Keeps edges short.",
    requires=("torch", "jaxtyping"),
    extra="reconstruct",
    traits=frozenset({"differentiable", "rigid_invariant"}),
    testing="hir_plugins.regularizers.contract_inputs:single_point",
)

BILATERAL_SPECULAR = Component(
    name="bilateral_specular",
    target="hir_plugins.regularizers.bilateral.bilateral_specular:BilateralSpecular",
    config=BilateralSpecularOptions,
    summary="Smooths the specular albedo between near points of similar diffuse albedo (the paper's term).",
    requires=("torch", "jaxtyping", "scipy"),
    extra="reconstruct",
    traits=frozenset({"differentiable", "scale_invariant", "material", "vertex_maps", "lagged"}),
    testing="hir_plugins.regularizers.contract_inputs:constant_specular",
)

JOINT_BILATERAL = Component(
    name="joint_bilateral",
    target="hir_plugins.regularizers.bilateral.joint_bilateral:JointBilateral",
    config=JointBilateralOptions,
    summary="Smooths all maps between near points that are similar in all maps; keeps the edges of each.",
    requires=("torch", "jaxtyping", "scipy"),
    extra="reconstruct",
    traits=frozenset({"differentiable", "scale_invariant", "material", "vertex_maps", "lagged"}),
    testing="hir_plugins.regularizers.contract_inputs:constant_textures",
)

ALBEDO_SCALE = Component(
    name="albedo_scale",
    target="hir_plugins.regularizers.albedo_scale:AlbedoScale",
    config=AlbedoScaleOptions,
    summary="Keeps the mean diffuse albedo at its initial value.",
    requires=("torch", "jaxtyping"),
    extra="reconstruct",
    traits=frozenset({"differentiable", "rigid_invariant", "scale_invariant", "material", "vertex_maps"}),
    testing="hir_plugins.regularizers.contract_inputs:constant_textures",
)

TOTAL_VARIATION = Component(
    name="total_variation",
    target="hir_plugins.regularizers.total_variation:TotalVariation",
    config=TotalVariationOptions,
    summary="Keeps textures, and optionally the light, piecewise constant.",
    requires=("torch", "jaxtyping"),
    extra="reconstruct",
    traits=frozenset(
        {"differentiable", "rigid_invariant", "scale_invariant", "material", "environment", "vertex_maps"}
    ),
    testing="hir_plugins.regularizers.contract_inputs:constant_textures",
)


@hookimpl
def hir_register_regularizers() -> list[Component]:
    return [
        LAPLACIAN,
        NORMAL_CONSISTENCY,
        EDGE_LENGTH,
        BILATERAL_SPECULAR,
        JOINT_BILATERAL,
        ALBEDO_SCALE,
        TOTAL_VARIATION,
    ]
