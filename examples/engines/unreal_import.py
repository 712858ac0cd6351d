"""Imports an exported .glb and its .hdr into the open level of Unreal Engine 5.4 or newer.

In the editor's console: py "…/unreal_import.py" "…/NAME.glb" "…/NAME.hdr". Not run by hir's tests:
docs/engines/unreal.md.
"""

import os
import sys

import unreal

FOLDER = "/Game/hir"
YAW_DEG = 180.0  # the importer makes Unreal's Y of glTF's +Z, our panorama's middle; Unreal's panorama has -Y there


def imported(file):
    """The assets that Interchange makes of a file."""
    task = unreal.AssetImportTask()
    task.filename = file
    task.destination_path = FOLDER + "/" + os.path.splitext(os.path.basename(file))[0]
    task.automated = True
    task.replace_existing = True
    task.save = True
    unreal.AssetToolsHelpers.get_asset_tools().import_asset_tasks([task])
    # Interchange leaves the task's list empty in some versions: then everything in the folder is taken
    paths = task.imported_object_paths or unreal.EditorAssetLibrary.list_assets(task.destination_path)
    return [unreal.load_asset(path) for path in paths]


def main(glb, hdr):
    """The mesh at the origin, a sky light with the panorama, no tone mapping."""
    actors = unreal.get_editor_subsystem(unreal.EditorActorSubsystem)
    meshes = [a for a in imported(glb) if isinstance(a, unreal.StaticMesh)]
    for mesh in meshes:
        actors.spawn_actor_from_object(mesh, unreal.Vector(0, 0, 0))
    cubes = [a for a in imported(hdr) if isinstance(a, unreal.TextureCube)]
    if not meshes or not cubes:
        raise RuntimeError(f"the importer made {len(meshes)} meshes and {len(cubes)} cubemaps")
    sky = actors.spawn_actor_from_class(unreal.SkyLight, unreal.Vector(0, 0, 0))
    light = sky.get_component_by_class(unreal.SkyLightComponent)
    light.set_editor_property("mobility", unreal.ComponentMobility.STATIONARY)
    light.set_editor_property("source_type", unreal.SkyLightSourceType.SLS_SPECIFIED_CUBEMAP)
    light.set_editor_property("cubemap", cubes[0])
    light.set_editor_property("source_cubemap_angle", YAW_DEG)
    light.set_editor_property("intensity", 1.0)
    light.set_editor_property("lower_hemisphere_is_black", False)

    volume = actors.spawn_actor_from_class(unreal.PostProcessVolume, unreal.Vector(0, 0, 0))
    volume.set_editor_property("unbound", True)
    settings = volume.get_editor_property("settings")
    for name, value in (
        ("auto_exposure_method", unreal.AutoExposureMethod.AEM_MANUAL),
        ("auto_exposure_apply_physical_camera_exposure", False),
        ("auto_exposure_bias", 0.0),
        ("tone_curve_amount", 0.0),
        ("expand_gamut", 0.0),
    ):
        settings.set_editor_property("override_" + name, True)
        settings.set_editor_property(name, value)
    volume.set_editor_property("settings", settings)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
