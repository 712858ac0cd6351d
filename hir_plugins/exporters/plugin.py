"""Descriptors of the built-in exporters, one for each format of `hir_exporters`."""

from __future__ import annotations

from hir_exporters.formats import FORMATS

from hir_core.plugins import Component, hookimpl

TRAITS = {
    **dict.fromkeys(("glb", "gltf"), "gltf"),
    **dict.fromkeys(("usda", "usdc", "usdz"), "usd"),
    **dict.fromkeys(("hdr", "exr", "ktx", "sh.json"), "environment"),
}
"""The type of document that `edit` receives, or `environment` for formats that contain only the light."""

REQUIRES = {"gltf": ("pygltflib",), "usd": ("pxr",)}

EXTRAS = {"usd": "usd"}
"""Extra of this distribution that installs what formats with a trait require; others are in the base install."""


def exporter_component(name: str) -> Component:
    """The descriptor of a format's exporter."""
    trait = TRAITS.get(name, "")
    return Component(
        name=name,
        target=FORMATS[name].target,
        config=FORMATS[name].config,
        summary=FORMATS[name].summary,
        requires=REQUIRES.get(trait, ()),
        extra=EXTRAS.get(trait, ""),
        traits=frozenset({trait} - {""}),
    )


@hookimpl
def hir_register_exporters() -> list[Component]:
    return [exporter_component(name) for name in FORMATS]
