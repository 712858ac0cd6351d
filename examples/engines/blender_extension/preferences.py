"""Preferences of the add-on."""

import bpy


class HirPreferences(bpy.types.AddonPreferences):
    """Where the program is."""

    bl_idname = __package__

    program: bpy.props.StringProperty(
        name="Program",
        description="Path of the program hir, or its name if it is on the PATH",
        subtype="FILE_PATH",
        default="hir",
    )

    def draw(self, context):
        self.layout.prop(self, "program")


def hir_program(context):
    """The path or name of `hir` that the user has set."""
    return context.preferences.addons[__package__].preferences.program
