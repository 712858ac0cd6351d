"""3D view > sidebar > hir > Refit materials from photographs."""

import shlex
import tempfile
from itertools import count
from pathlib import Path
from typing import ClassVar

import bpy

from .gltf_import import import_glb
from .hir_process import HirError
from .material_transfer import transfer_material
from .process_operator import HirProcessOperator
from .run_folder import check_run, exported_asset, exported_light
from .scan_file import AXES, check_scan, write_scan
from .world_light import set_world_light, use_standard_view

SETTINGS = ('export=["glb", "exr"]', 'exporter.glb.profile="blender"', "observers.progress_file={}")


class RefitMaterials(HirProcessOperator, bpy.types.Operator):
    """Replace the materials of the active mesh by those that hir finds in photographs; mesh and UV map stay"""

    bl_idname = "hir.refit_materials"
    bl_label = "Refit materials from photographs"
    bl_options: ClassVar = {"UNDO"}  # no REGISTER: its redo panel would run hir again for each change

    directory: bpy.props.StringProperty(
        name="Photographs",
        description="Folder of the photographs and of the file with their cameras",
        subtype="DIR_PATH",
    )
    filter_folder: bpy.props.BoolProperty(default=True, options={"HIDDEN"})
    axes: bpy.props.EnumProperty(
        name="Axes",
        description="How the scan was imported",
        items=[
            ("SOURCE_TURNED", "Import turned +Y up", "OBJ or FBX with the importer's defaults; axes of the cameras"),
            ("SOURCE", "Import kept the axes", "PLY, STL, or forward Y and up Z; axes of the cameras"),
            ("GLTF", "glTF", "glTF; the photographs show in which axes it was written"),
        ],
        default="SOURCE_TURNED",
    )
    align: bpy.props.BoolProperty(
        name="Align",
        description="Align the mesh with points of the photographs; always done where these have no cameras",
        default=False,
    )
    run: bpy.props.StringProperty(
        name="Run", description="Folder that hir writes; empty for a new one beside the photographs", subtype="DIR_PATH"
    )
    settings: bpy.props.StringProperty(
        name="Settings", description="Settings of hir, KEY=VALUE, with spaces between them", default=""
    )
    with_light: bpy.props.BoolProperty(
        name="Light", description="Use the light that was found as the world of the scene", default=True
    )
    standard_view: bpy.props.BoolProperty(
        name="Standard view transform", description="AgX, Blender's default, changes all colours", default=True
    )

    _item_name = ""
    _run_folder = None
    _temporary = None

    @classmethod
    def poll(cls, context):
        return context.object is not None and context.object.type == "MESH" and context.mode == "OBJECT"

    def invoke(self, context, event):
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context):
        try:
            item = context.object
            check_scan(item)
            photos = Path(bpy.path.abspath(self.directory))
            if not self.directory or not photos.is_dir():
                raise HirError(f"{photos} is not a folder of photographs")
            try:
                settings = shlex.split(self.settings, posix=False)
            except ValueError as error:
                raise HirError(f"the settings {self.settings!r} have an open quote") from error
            self._run_folder = Path(bpy.path.abspath(self.run)) if self.run else new_run_folder(photos)
            self._item_name = item.name
            self._temporary = tempfile.TemporaryDirectory(prefix="hir-scan-")
            scan = Path(self._temporary.name) / "scan.glb"
            y_up, axes = AXES[self.axes]
            write_scan(context, item, scan, y_up)
        except HirError as error:
            return self.fail(error)
        arguments = ["delight", scan, photos, "-o", self._run_folder, "--axes", axes, "-q"]
        arguments += ["--align"] if self.align else []
        for setting in (*SETTINGS, *settings):
            arguments += ["--set", setting]
        return self.run_hir(context, arguments, self._run_folder)

    def finish(self, context):
        item = bpy.data.objects.get(self._item_name)  # by name: undo replaces objects
        if item is None:
            raise HirError(f"the object {self._item_name!r} is gone; the result is in {self._run_folder}")
        check_run(self._run_folder)
        asset = exported_asset(self._run_folder)
        if asset is None:
            raise HirError(f"hir has written no .glb to {self._run_folder / 'exports'}")
        light = exported_light(asset)
        rotation = transfer_material(import_glb(asset), item)
        if self.with_light:
            if light is None:
                raise HirError(f"there is no light beside {asset}")
            set_world_light(context.scene, light, rotation)
        if self.standard_view:
            use_standard_view(context.scene)
        item.select_set(True)  # the importer has selected what it imported
        context.view_layer.objects.active = item
        self.report({"INFO"}, f"materials of {item.name!r} are from {self._run_folder}")

    def discard(self):
        if self._temporary is not None:
            self._temporary.cleanup()
            self._temporary = None


def new_run_folder(photos):
    """A folder beside the photographs that does not exist."""
    for number in count(1):
        folder = photos.parent / f"{photos.name}_hir_{number}"
        if not folder.exists():
            return folder
    raise AssertionError


class RefitPanel(bpy.types.Panel):
    """The tab "hir" of the 3D view's sidebar"""

    bl_idname = "HIR_PT_refit"
    bl_label = "hir"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "hir"

    def draw(self, context):
        self.layout.operator(RefitMaterials.bl_idname, icon="MATERIAL")
