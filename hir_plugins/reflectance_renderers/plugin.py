"""Components of the built-in reflectance renderers."""

from __future__ import annotations

from hir_core.plugins import Component, hookimpl
from hir_plugins.reflectance_renderers.mitsuba_ggx.options import MitsubaGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions

TRANSPORT_GGX = Component(
    name="transport_ggx",
    target="hir_plugins.reflectance_renderers.transport_ggx.renderer:TransportGGX",
    config=TransportGGXOptions,
    summary="Cached light transport for frozen geometry: rays are traced once, steps are linear algebra.",
    requires=("torch", "jaxtyping", "mitsuba", "scipy"),
    extra="reconstruct",
    traits=frozenset({"material", "environment", "solver", "regularizers", "exposures", "camera_lamp", "takes"}),
)

MITSUBA_GGX = Component(
    name="mitsuba_ggx",
    target="hir_plugins.reflectance_renderers.mitsuba_ggx.renderer:MitsubaGGX",
    config=MitsubaGGXOptions,
    summary="Path tracing of the same BRDFs: the unbiased reference for fits and evaluation.",
    requires=("torch", "jaxtyping", "mitsuba"),
    extra="reconstruct",
    traits=frozenset({"material", "environment", "stochastic", "reference", "camera_lamp"}),
)


@hookimpl
def hir_register_reflectance_renderers() -> list[Component]:
    return [TRANSPORT_GGX, MITSUBA_GGX]
