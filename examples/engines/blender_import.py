"""Opens an exported file in Blender in its own light.

    blender --python blender_import.py -- NAME.glb NAME.hdr [PICTURE.png]

With a .usda, .usdc or .usdz give NAME_usda_lit.usda (NAME_usdc_…, NAME_usdz_…) alone: its dome light becomes the
world. With a picture, Cycles renders it.
"""

import math
import sys

import bpy
from mathutils import Vector


def main(asset, light=None, picture=None):
    """Imports the file, sets the light and colour management, places a camera, renders where a picture is named."""
    bpy.ops.wm.read_homefile(use_empty=True)
    scene = bpy.context.scene
    # the USD importer fills the world with the dome light only where there is a world
    scene.world = bpy.data.worlds.new("light")
    if asset.lower().endswith((".glb", ".gltf")):
        bpy.ops.import_scene.gltf(filepath=asset)
    else:
        bpy.ops.wm.usd_import(filepath=asset, create_world_material=light is None)
    if light is not None:
        set_light(scene.world, light)
    scene.view_settings.view_transform = "Standard"  # AgX, the default, changes every colour
    scene.view_settings.look = "None"
    place_camera(scene)
    if picture is not None:
        scene.render.engine = "CYCLES"
        scene.cycles.samples = 64
        scene.render.resolution_x = scene.render.resolution_y = 512
        scene.render.filepath = picture
        bpy.ops.render.render(write_still=True)


def set_light(world, hdr):
    """The panorama has glTF's +Z, which is Blender's -Y, in its middle; Blender has +X there: a quarter turn."""
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    place, turn = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeMapping")
    turn.inputs["Rotation"].default_value = (0, 0, math.radians(90))
    image = nodes.new("ShaderNodeTexEnvironment")
    image.image = bpy.data.images.load(hdr)
    links.new(place.outputs["Generated"], turn.inputs["Vector"])
    links.new(turn.outputs["Vector"], image.inputs["Vector"])
    links.new(image.outputs["Color"], nodes["Background"].inputs["Color"])


def place_camera(scene):
    """In front of everything, a little above."""
    corners = [o.matrix_world @ Vector(c) for o in scene.objects if o.type == "MESH" for c in o.bound_box]
    low = Vector(min(c[i] for c in corners) for i in range(3))
    high = Vector(max(c[i] for c in corners) for i in range(3))
    center, radius = (low + high) / 2, (high - low).length / 2
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.angle = math.radians(35)
    camera.data.clip_start, camera.data.clip_end = radius / 100, radius * 100
    away = Vector((0.5, -1.0, 0.4)).normalized()
    camera.location = center + away * radius * 3.6
    camera.rotation_euler = away.to_track_quat("Z", "Y").to_euler()
    scene.collection.objects.link(camera)
    scene.camera = camera


if __name__ == "__main__":
    words = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    hdr = words[1] if len(words) > 1 and words[1].endswith((".hdr", ".exr")) else None
    main(words[0], hdr, words[-1] if words[-1].endswith(".png") else None)
