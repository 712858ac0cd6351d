"""The Blender extension of hir: imports runs, and refits materials of a mesh from photographs.

It calls the program hir in a process of its own. docs/engines/blender.md describes it.
"""

import bpy

from .import_run import ImportRun, draw_menu
from .preferences import HirPreferences
from .refit_materials import RefitMaterials, RefitPanel

CLASSES = (HirPreferences, ImportRun, RefitMaterials, RefitPanel)


def register():
    for item in CLASSES:
        bpy.utils.register_class(item)
    bpy.types.TOPBAR_MT_file_import.append(draw_menu)


def unregister():
    bpy.types.TOPBAR_MT_file_import.remove(draw_menu)
    for item in reversed(CLASSES):
        bpy.utils.unregister_class(item)
