"""Descriptors of the built-in readers."""

from __future__ import annotations

from hir_core.plugin import Component, hookimpl

TRANSFORMS_JSON = Component(
    name="transforms_json",
    target="hir_plugins.readers.transforms_json:TransformsJsonReader",
    summary="NeRF-synthetic, nerfstudio and instant-ngp: transforms.json or one transforms_<split>.json a split.",
)

COLMAP_MODEL = Component(
    name="colmap_model",
    target="hir_plugins.readers.colmap_model:ColmapModelReader",
    summary="A COLMAP model, text or binary, with the folder of its images.",
)

PHOTOS = Component(
    name="photos",
    target="hir_plugins.readers.photos:PhotosReader",
    summary="A plain folder of photographs, with masks beside them or without.",
)


@hookimpl
def hir_register_capture_readers() -> list[Component]:
    return [TRANSFORMS_JSON, COLMAP_MODEL, PHOTOS]
