"""Renders an exported file in Cycles: `python render_in_blender.py ASSET LIGHT.hdr|- SHOTS.json FOLDER [SAMPLES]`.

ASSET is a .glb, .gltf or any USD; `-` for a USD whose own dome light is used. Writes FOLDER/0.png, 1.png and so on.
Runs in an environment of its own, with bpy 5.0.1 (Python 3.11, numpy < 2): `tools/setup.sh blender` makes it.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import bpy
from mathutils import Matrix

BLENDER_FROM_GLTF = Matrix(((1, 0, 0, 0), (0, 0, -1, 0), (0, 1, 0, 0), (0, 0, 0, 1)))
"""Blender's importers turn +Y up into +Z up."""


def main(asset: str, light: str, shots_file: str, folder: str, samples: str = "64") -> None:
    """Cycles on the processor, film transparent, no tone mapping: the PNGs are sRGB of radiance."""
    shots = json.loads(Path(shots_file).read_text(encoding="utf-8"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    # the USD importer turns a dome light into the scene's world only where there is one, as a new file has
    bpy.context.scene.world = bpy.data.worlds.new("light")
    if asset.endswith((".glb", ".gltf")):
        # RAW: lights of the file keep their values; by default lux are divided by 683 lm/W
        bpy.ops.import_scene.gltf(filepath=asset, export_import_convert_lighting_mode="RAW")
    else:
        bpy.ops.wm.usd_import(filepath=asset, create_world_material=light == "-")
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = int(samples)
    scene.cycles.seed = 1
    scene.cycles.use_denoising = False
    scene.render.film_transparent = True
    scene.render.resolution_percentage = 100
    scene.view_settings.view_transform = "Standard"
    scene.view_settings.look = "None"
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGBA"
    if light != "-":
        set_light(scene, light)
    for index, shot in enumerate(shots):
        scene.camera = camera_of(scene, shot)
        scene.render.resolution_x, scene.render.resolution_y = shot["width"], shot["height"]
        scene.render.filepath = str(Path(folder) / f"{index}.png")
        bpy.ops.render.render(write_still=True)


def camera_of(scene: bpy.types.Scene, shot: dict[str, Any]) -> bpy.types.Object:
    """A camera at the shot's place."""
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.sensor_fit = "VERTICAL"
    camera.data.angle_y = math.radians(shot["fov_y_deg"])
    camera.data.clip_start, camera.data.clip_end = shot["near"], shot["far"]
    columns = shot["camera_to_world_columns"]
    camera.matrix_world = BLENDER_FROM_GLTF @ Matrix([columns[i::4] for i in range(4)])
    scene.collection.objects.link(camera)
    return camera


def set_light(scene: bpy.types.Scene, hdr: str) -> None:
    """Our panorama has +Z of glTF (Blender's -Y) in its centre, Blender's has +X there: a quarter turn about Z."""
    world = scene.world
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
    main(*sys.argv[1:6])
