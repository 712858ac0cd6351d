"""Renders a .glb under a lat-long light: `python render_in_blender.py asset.glb asset.hdr shot.json picture.png`.

Runs in an environment of its own, with bpy 5.0.1 (Python 3.11, numpy < 2): `tools/setup.sh blender` makes it.
"""

from __future__ import annotations

import json
import math
import sys

import bpy
from mathutils import Matrix

BLENDER_FROM_GLTF = Matrix(((1, 0, 0, 0), (0, 0, -1, 0), (0, 1, 0, 0), (0, 0, 0, 1)))
"""Blender's importer turns +Y up into +Z up."""


def main(glb: str, hdr: str, shot_file: str, picture: str) -> None:
    """Cycles on the processor, film transparent, no tone mapping: the PNG is sRGB of radiance."""
    with open(shot_file, encoding="utf-8") as stream:
        shot = json.load(stream)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=glb)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = 64
    scene.cycles.seed = 1
    scene.render.film_transparent = True
    scene.render.resolution_x, scene.render.resolution_y = shot["width"], shot["height"]
    scene.render.resolution_percentage = 100
    scene.view_settings.view_transform = "Standard"
    scene.view_settings.look = "None"
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGBA"
    light(scene, hdr)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.sensor_fit = "VERTICAL"
    camera.data.angle_y = math.radians(shot["fov_y_deg"])
    columns = shot["camera_to_world_columns"]
    camera.matrix_world = BLENDER_FROM_GLTF @ Matrix([columns[i::4] for i in range(4)])
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.filepath = picture
    bpy.ops.render.render(write_still=True)


def light(scene: bpy.types.Scene, hdr: str) -> None:
    """Our panorama has +Z of glTF (Blender's -Y) in its centre, Blender's has +X there: a quarter turn about Z."""
    world = bpy.data.worlds.new("light")
    scene.world = world
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    place, turn = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeMapping")
    turn.inputs["Rotation"].default_value = (0, 0, math.radians(90))
    image = nodes.new("ShaderNodeTexEnvironment")
    image.image = bpy.data.images.load(hdr)
    links.new(place.outputs["Generated"], turn.inputs["Vector"])
    links.new(turn.outputs["Vector"], image.inputs["Vector"])
    links.new(image.outputs["Color"], nodes["Background"].inputs["Color"])


if __name__ == "__main__":
    main(*sys.argv[1:5])
