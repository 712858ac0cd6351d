"""A mesh of the scene as the file of a scan, which `hir delight` reads."""

import bpy

from .hir_process import HirError

AXES = {
    "GLTF": (True, "auto"),
    "SOURCE_TURNED": (True, "source"),
    "SOURCE": (False, "source"),
}
"""Choice → whether Blender's +Z up is turned to +Y up in the file, and the `--axes` of `hir delight`."""


def check_scan(item):
    """Raises `HirError` unless the object is a mesh with a UV map, in object mode."""
    if item is None or item.type != "MESH":
        raise HirError("select the mesh of the scan first")
    if item.mode != "OBJECT":
        raise HirError(f"leave the edit mode of {item.name!r} first")
    if not item.data.uv_layers:
        raise HirError(f"{item.name!r} has no UV map: unwrap it first (U in edit mode)")


def render_uv_map(mesh):
    """The name of the UV map that textures use."""
    return next(layer.name for layer in mesh.uv_layers if layer.active_render)


def write_scan(context, item, file, y_up):
    """Writes the object as it is seen (modifiers applied, in world coordinates), with the UV map that textures use."""
    mesh = bpy.data.meshes.new_from_object(item.evaluated_get(context.evaluated_depsgraph_get()))
    copy = bpy.data.objects.new("hir scan", mesh)
    selected, active = list(context.selected_objects), context.view_layer.objects.active
    try:
        if not mesh.uv_layers or not mesh.polygons:
            raise HirError(f"the modifiers of {item.name!r} leave no faces with a UV map")
        mesh.transform(item.matrix_world)
        if item.matrix_world.is_negative:
            mesh.flip_normals()
        kept = render_uv_map(mesh)
        for name in [layer.name for layer in mesh.uv_layers if layer.name != kept]:
            mesh.uv_layers.remove(mesh.uv_layers[name])
        context.scene.collection.objects.link(copy)
        for other in selected:
            other.select_set(False)
        copy.select_set(True)
        context.view_layer.objects.active = copy
        # without normals: vertices are not split where shading is flat
        bpy.ops.export_scene.gltf(
            filepath=str(file),
            export_format="GLB",
            use_selection=True,
            export_yup=y_up,
            export_normals=False,
            export_materials="EXPORT",  # hir compares its textures with the old one
            export_animations=False,
        )
    except RuntimeError as error:
        raise HirError(f"the mesh could not be written: {str(error).strip().splitlines()[-1]}") from error
    finally:
        bpy.data.meshes.remove(mesh)  # and the copy with it
        for other in selected:
            other.select_set(True)
        context.view_layer.objects.active = active
