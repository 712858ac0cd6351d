"""What broken renderers of this folder are made of: the path tracer with direct light, and its descriptor."""

from __future__ import annotations

from typing import Any

from hir_core.plugins import Component, NoOptions
from hir_core.plugins.interfaces import PreparedReflectance, ReflectanceRenderer


class Traced(ReflectanceRenderer):
    def __init__(self, config: NoOptions) -> None:
        from hir_plugins.reflectance_renderers.mitsuba_ggx.options import MitsubaGGXOptions
        from hir_plugins.reflectance_renderers.mitsuba_ggx.renderer import MitsubaGGX

        self.inner = MitsubaGGX(MitsubaGGXOptions(samples=64, render_samples=64, max_depth=2))

    def prepare(self, scene: Any, capture: Any, downsample: int = 1) -> PreparedReflectance:
        return Prepared(self, self.inner.prepare(scene, capture, downsample))

    def render(self, scene: Any, camera: Any) -> Any:
        return self.inner.render(scene, camera)

    def light(self, environment: Any) -> Any:
        """The light that is used in the place of the one given."""
        return environment

    def shown(self, radiance: Any) -> Any:
        """What is returned in the place of the radiance."""
        return radiance


class Prepared(PreparedReflectance):
    def __init__(self, renderer: Traced, inner: PreparedReflectance) -> None:
        self.renderer, self.inner = renderer, inner

    def radiance(self, material: Any, environment: Any, pixels: Any) -> Any:
        return self.renderer.shown(self.inner.radiance(material, self.renderer.light(environment), pixels))


def descriptor(target: str) -> Component:
    """A descriptor of a renderer."""
    traits = frozenset({"material", "environment", "stochastic"})
    needs = ("torch", "jaxtyping", "mitsuba")
    return Component("traced", target, summary="Traces paths.", requires=needs, traits=traits)
