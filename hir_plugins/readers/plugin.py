"""Descriptors of the built-in readers."""

from __future__ import annotations

from hir_core.plugin import Component, hookimpl

TRANSFORMS_JSON = Component(
    name="transforms_json",
    target="hir_plugins.readers.transforms_json:TransformsJsonReader",
    summary="NeRF-synthetic, nerfstudio and instant-ngp: transforms.json or one transforms_<split>.json a split.",
)


@hookimpl
def hir_register_capture_readers() -> list[Component]:
    return [TRANSFORMS_JSON]
