"""Import of a .glb by Blender's own importer."""

import bpy

from .hir_process import HirError

NO_FRESNEL_IOR = 1000.0
"""The index of refraction by which glTF says that a material has no Fresnel term."""


def import_glb(file):
    """The objects of the file, linked to the active collection; raises `HirError`."""
    before = set(bpy.data.objects)
    try:
        # RAW: lights of the file keep their values; by default lux are divided by 683 lm/W
        bpy.ops.import_scene.gltf(filepath=str(file), export_import_convert_lighting_mode="RAW")
    except RuntimeError as error:
        raise HirError(f"{file} could not be imported: {str(error).strip().splitlines()[-1]}") from error
    objects = [item for item in bpy.data.objects if item not in before]
    if not any(item.type == "MESH" for item in objects):
        raise HirError(f"{file} has no mesh")
    return objects


def lacks_fresnel(material):
    """Whether the material is one that Blender shows rightly only if it was exported for Blender."""
    shaders = [node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED"]
    return any(node.inputs["IOR"].default_value >= NO_FRESNEL_IOR for node in shaders)
