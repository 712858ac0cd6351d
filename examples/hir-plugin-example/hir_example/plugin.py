"""Descriptors: what `hir` loads when it starts. Nothing heavy is imported here."""

from __future__ import annotations

from pathlib import Path

from hir_core.plugins import Component, hookimpl
from hir_example.options import LightChromaOptions, MidpointOptions, PlyOptions, SupersampledOptions

LIGHT_CHROMA = Component(
    name="light_chroma",
    target="hir_example.light_chroma:LightChroma",
    config=LightChromaOptions,
    summary="Keeps the light's texels near grey.",
    requires=("torch", "jaxtyping"),
    extra="reconstruct",
    traits=frozenset({"differentiable", "environment", "rigid_invariant", "scale_invariant"}),
    api=1,
    testing="hir_example.light_chroma:grey_light",
    docs="hir_example:light_chroma.md",
)

MIDPOINT_OUTLINE = Component(
    name="midpoint_outline",
    target="hir_example.midpoint_outline:MidpointOutline",
    config=MidpointOptions,
    summary="Silhouettes by counting samples, their gradients from the middles of the outline's edges.",
    requires=("torch", "jaxtyping"),
    extra="reconstruct",
    traits=frozenset({"differentiable"}),
    api=1,
)

SUPERSAMPLED = Component(
    name="supersampled",
    target="hir_example.supersampled:Supersampled",
    config=SupersampledOptions,
    summary="Another renderer's shading, with pictures averaged from larger ones.",
    requires=("torch", "jaxtyping", "mitsuba"),
    extra="reconstruct",
    traits=frozenset({"material", "environment", "stochastic"}),
    api=1,
)

PLY = Component(
    name="ply",
    target="hir_example.colored_ply:ColoredPly",
    config=PlyOptions,
    summary="Stanford PLY with the albedo as vertex colours.",
    api=1,
)


@hookimpl
def hir_register_presets() -> dict[str, Path]:
    return {"grey_light": Path(__file__).parent / "grey_light.toml"}


@hookimpl
def hir_register_regularizers() -> list[Component]:
    return [LIGHT_CHROMA]


@hookimpl
def hir_register_geometry_renderers() -> list[Component]:
    return [MIDPOINT_OUTLINE]


@hookimpl
def hir_register_reflectance_renderers() -> list[Component]:
    return [SUPERSAMPLED]


@hookimpl
def hir_register_exporters() -> list[Component]:
    return [PLY]
