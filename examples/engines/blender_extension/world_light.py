"""The fitted light of a run as the world of a scene."""

import math

import bpy
from mathutils import Matrix

BLENDER_FROM_PANORAMA = Matrix.Rotation(math.radians(90), 3, "Z")
"""The panorama has +Z of glTF, which is Blender's -Y, in its middle; Blender has +X there: a quarter turn."""


def set_world_light(scene, file, asset_rotation=None):
    """A new world with the panorama `file`; the world that the scene had stays in the file.

    `asset_rotation` (3×3) rotates the asset as its .glb is imported to the asset as it lies in the scene.
    """
    world = bpy.data.worlds.new(f"hir {file.stem}")
    if not world.use_nodes:  # Blender before 5.0
        world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    background = next(node for node in nodes if node.type == "BACKGROUND")
    place, turn = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeMapping")
    panorama = nodes.new("ShaderNodeTexEnvironment")
    lookup = BLENDER_FROM_PANORAMA
    if asset_rotation is not None:
        lookup = lookup @ asset_rotation.transposed()
    turn.inputs["Rotation"].default_value = lookup.to_euler("XYZ")
    panorama.image = bpy.data.images.load(str(file))
    panorama.image.colorspace_settings.name = "Linear Rec.709"
    panorama.image.pack()
    links.new(place.outputs["Generated"], turn.inputs["Vector"])
    links.new(turn.outputs["Vector"], panorama.inputs["Vector"])
    links.new(panorama.outputs["Color"], background.inputs["Color"])
    for column, node in enumerate((place, turn, panorama)):
        node.location = (background.location.x - 220 * (4 - column), background.location.y)
    scene.world = world
    return world


def use_standard_view(scene):
    """AgX, the default view transform, changes all colours."""
    scene.view_settings.view_transform = "Standard"
    scene.view_settings.look = "None"
