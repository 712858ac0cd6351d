"""Descriptors of the built-in exporters: one for each format of `hir_exporters`."""

from __future__ import annotations

from hir_exporters.formats import FORMATS

from hir_core.plugins import Component, hookimpl

TRAITS = {
    **dict.fromkeys(("glb", "gltf"), "gltf"),
    **dict.fromkeys(("usda", "usdc", "usdz"), "usd"),
    **dict.fromkeys(("hdr", "exr", "ktx", "dds", "sh.json"), "environment"),
}
"""The document that plugins may change before its bytes are made; or that the light alone is written."""

REQUIRES = {"gltf": ("pygltflib",), "usd": ("pxr",)}


def component(name: str) -> Component:
    """The descriptor of one format."""
    trait = TRAITS.get(name, "")
    return Component(
        name=name,
        target=FORMATS[name].target,
        config=FORMATS[name].config,
        summary=FORMATS[name].summary,
        requires=REQUIRES.get(trait, ()),
        traits=frozenset({trait} - {""}),
    )


@hookimpl
def hir_register_exporters() -> list[Component]:
    return [component(name) for name in FORMATS]
