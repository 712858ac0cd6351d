"""Descriptors of the built-in mask sources."""

from __future__ import annotations

from hir_core.plugins import Component, hookimpl
from hir_plugins.masks.options import (
    ColorKeyOptions,
    FolderOptions,
    GrabCutOptions,
    RembgOptions,
)

ALPHA = Component(
    name="alpha",
    target="hir_plugins.masks.alpha:Alpha",
    summary="The alpha channel of the photographs, or the mask files that the capture names.",
    traits=frozenset({"automatic"}),
    testing="hir_plugins.masks.contract_inputs:photographs_with_alpha",
)

FOLDER = Component(
    name="folder",
    target="hir_plugins.masks.folder:Folder",
    config=FolderOptions,
    summary="A folder of mask files, matched with the photographs by name.",
    traits=frozenset({"automatic", "reads_files"}),
    testing="hir_plugins.masks.contract_inputs:folder_of_masks",
)

COLOR_KEY = Component(
    name="color_key",
    target="hir_plugins.masks.color_key:ColorKey",
    config=ColorKeyOptions,
    summary="Chroma keying, for a background of one colour: black, white, green or blue.",
    requires=("scipy",),
    extra="reconstruct",
)

GRABCUT = Component(
    name="grabcut",
    target="hir_plugins.masks.grabcut:GrabCut",
    config=GrabCutOptions,
    summary="GrabCut: segmentation by colour, initialised by the reconstructed points.",
    requires=("cv2", "scipy"),
    extra="reconstruct",
    traits=frozenset({"automatic", "needs_cameras"}),
)

REMBG = Component(
    name="rembg",
    target="hir_plugins.masks.rembg:Rembg",
    config=RembgOptions,
    summary="A segmentation network (rembg), with weights that are already on this machine.",
    requires=("rembg", "onnxruntime"),
    extra="rembg",
    testing="hir_plugins.masks.contract_inputs:photographs_with_weights",
)


MESH_SILHOUETTE = Component(
    name="mesh_silhouette",
    target="hir_plugins.masks.mesh_silhouette:MeshSilhouette",
    summary="The silhouette of a mesh that is already there, such as a scan.",
    requires=("torch", "jaxtyping"),
    extra="reconstruct",
    traits=frozenset({"needs_mesh"}),
)


@hookimpl
def hir_register_mask_sources() -> list[Component]:
    return [ALPHA, FOLDER, COLOR_KEY, GRABCUT, REMBG, MESH_SILHOUETTE]
