"""File > Import > hir run."""

from pathlib import Path
from typing import ClassVar

import bpy

from .gltf_import import import_glb, lacks_fresnel
from .hir_process import HirError
from .process_operator import HirProcessOperator
from .run_folder import check_run, exported_asset, exported_light
from .world_light import set_world_light, use_standard_view

FORMATS = ("-f", "glb", "-f", "exr", "--profile", "blender", "--no-verify")
"""Options of `hir export` for Blender."""


class ImportRun(HirProcessOperator, bpy.types.Operator):
    """Import the asset of a folder that hir has written, and its light"""

    bl_idname = "hir.import_run"
    bl_label = "Import hir run"
    bl_options: ClassVar = {"UNDO"}  # no REGISTER: its redo panel would run hir again for each change

    directory: bpy.props.StringProperty(name="Run", description="Folder of the run", subtype="DIR_PATH")
    filter_folder: bpy.props.BoolProperty(default=True, options={"HIDDEN"})
    with_light: bpy.props.BoolProperty(
        name="Light", description="Use the light of the run as the world of the scene", default=True
    )
    standard_view: bpy.props.BoolProperty(
        name="Standard view transform", description="AgX, Blender's default, changes all colours", default=True
    )
    export_again: bpy.props.BoolProperty(
        name="Export again for Blender",
        description="Write the files of exports/ again with the profile of Blender, even if they exist",
        default=False,
    )

    def invoke(self, context, event):
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context):
        run = Path(bpy.path.abspath(self.directory))
        try:
            check_run(run)
            asset = exported_asset(run)
            light_missing = self.with_light and (asset is None or exported_light(asset) is None)
            if asset is not None and not light_missing and not self.export_again:
                self.finish(context)
                return {"FINISHED"}
        except HirError as error:
            return self.fail(error)
        return self.run_hir(context, ["export", run, *FORMATS, "-o", run / "exports", "-q"], run)

    def finish(self, context):
        asset = exported_asset(Path(bpy.path.abspath(self.directory)))
        if asset is None:
            raise HirError("hir export has written no .glb")
        light = exported_light(asset)
        if self.with_light and light is None:
            raise HirError(f"there is no light beside {asset}")
        objects = import_glb(asset)
        if self.with_light:
            set_world_light(context.scene, light)
        if self.standard_view:
            use_standard_view(context.scene)
        materials = [slot.material for item in objects for slot in item.material_slots if slot.material]
        if not self.export_again and any(map(lacks_fresnel, materials)):
            self.report(
                {"WARNING"},
                "the material has no Fresnel term: if it was not exported for Blender, import it with "
                "'Export again for Blender'",
            )


def draw_menu(self, context):
    self.layout.operator(ImportRun.bl_idname, text="hir run (folder)")
